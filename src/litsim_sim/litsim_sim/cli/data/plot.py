"""`data plot`: a recording as space-time diagrams by lane and a map of its tracks, or as an intersection."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from litsim_sim.cli.recordings import describe, net_of
from litsim_sim.core.errors import InputError
from litsim_sim.maps.lane_map import LaneMap
from litsim_sim.recordings.load import load_recording
from litsim_sim.recordings.recording import Recording
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import recorded_signals
from litsim_sim.scenario.signals import Signals, build


def add(subparsers: Any) -> None:
    """Add the parser of the command."""
    command = subparsers.add_parser("plot", help="draw space-time diagrams by lane and a map of the tracks")
    command.add_argument("recording", type=Path, help="recording of any known format")
    command.add_argument(
        "out", type=Path, metavar="OUT", help="OUT.png, or OUT.html for a page that needs no other file"
    )
    command.add_argument(
        "--net", help="net under the tracks: file, or name of a packaged one; default: that of the header"
    )
    crop_help = "draw rows with COLUMN, as named in the file, from LOW through HIGH; may be repeated"
    command.add_argument("--crop", nargs=3, action="append", metavar=("COLUMN", "LOW", "HIGH"), help=crop_help)
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Draw.

    Raises:
        InputError: the recording or the net cannot be used, or OUT cannot be written.
    """
    from litsim_sim.cli.data.convert import parse_crop
    from litsim_sim.report.recording_plots import draw  # matplotlib takes half a second to load

    recording = load_recording(arguments.recording, parse_crop(arguments.crop))
    net = _net(recording, arguments.recording, arguments.net)
    lane_map = None if net is None else LaneMap.from_net(net)
    signals = None if net is None else _signals(recording, net, arguments.recording)
    try:
        draw(recording, arguments.out, describe(recording), lane_map, signals)
    except OSError as error:
        raise InputError(f"{arguments.out}: cannot be written: {error.strerror or error}") from error
    print(arguments.out)


def _signals(recording: Recording, net: Path, path: Path) -> Signals | None:
    """What the signals of the recording showed, if it carries any of this net.

    Raises:
        InputError: they cannot be used.
    """
    given = recorded_signals(recording.header, net, str(path))
    if given is None:
        return None
    frames = recording.table["frame"]
    first, count = int(frames.min()), int(frames.max() - frames.min()) + 1
    return build(given, net, Log.from_recording(recording, first, count), first, str(path))


def _net(recording: Recording, path: Path, named: str | None) -> Path | None:
    """The net that is named, or the one that the header names; None where there is none of the latter.

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
