"""`data plot`: a recording as space-time diagrams by lane and a map of its tracks, or as an intersection."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from litsim_data.generic.description import describe
from litsim_sim.cli.arguments import number
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recorded_net import net_of
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import recorded_signals
from litsim_sim.scenario.signals import Signals, build, read_signals


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser("plot", help="draw space-time diagrams by lane and a map of the tracks")
    command.add_argument("recording", type=Path, help="recording of any known format")
    command.add_argument("out", type=Path, metavar="OUT", help="OUT.png, or OUT.html for a self-contained page")
    command.add_argument(
        "--net", help="net under the tracks: file, or name of a packaged one; default: the net of the header"
    )
    signals_help = "file of signals (YAML, see docs/signals.md) to show, instead of those that the recording carries"
    command.add_argument("--signals", type=Path, metavar="FILE", help=signals_help)
    at_help = "draw an intersection as it was S seconds after the first frame, with what its stop lines showed then"
    command.add_argument("--at", type=number(0.0), nargs="+", default=[], metavar="S", help=at_help)
    crop_help = "draw only rows with LOW <= COLUMN <= HIGH; may be repeated"
    command.add_argument("--crop", nargs=3, action="append", metavar=("COLUMN", "LOW", "HIGH"), help=crop_help)
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Draws the recording.

    Raises:
        InputError: the recording, the net or the signals cannot be used, or OUT cannot be written.
    """
    from litsim_data.cli.import_ import parse_crop
    from litsim_data.pictures.recording_plots import draw  # matplotlib takes half a second to load

    recording = load_recording(arguments.recording, parse_crop(arguments.crop))
    net = _net(recording, arguments.recording, arguments.net)
    lane_map = None if net is None else LaneMap.from_net(net)
    signals = _signals(recording, net, arguments)
    draw(recording, arguments.out, describe(recording), lane_map, signals, arguments.at)
    print(arguments.out)


def _signals(recording: Recording, net: Path | None, arguments: argparse.Namespace) -> Signals | None:
    """Returns what the signals that are named showed, or else those that the recording carries, if of this net.

    Raises:
        InputError: they cannot be used; or some are named, and there is no net.
    """
    named: Path | None = arguments.signals
    if net is None:
        if named is not None:
            raise InputError(f"{named}: signals need a net: name it with --net")
        return None
    where = str(named or arguments.recording)
    signals = recorded_signals(recording.header, net, where) if named is None else read_signals(named)
    if signals is None:
        return None
    frames = recording.table["frame"]
    first, count = int(frames.min()), int(frames.max() - frames.min()) + 1
    return build(signals, net, Log.from_recording(recording, first, count), first, where)


def _net(recording: Recording, path: Path, named: str | None) -> Path | None:
    """Returns the net that is named, or the one that the header names; None if the latter is missing.

    Raises:
        InputError: there is no such net as is named.
    """
    try:
        return net_of(recording.header, path, named)
    except InputError as error:
        if named:
            raise
        print(f"drawn without lanes: {error}", file=sys.stderr)
        return None
