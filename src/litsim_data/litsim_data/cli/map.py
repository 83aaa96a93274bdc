"""`data map`: build a net, from a recording or from a map of another format; put lights on one; or check one."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from litsim_data.maps.map_format import MapFormat
from litsim_sim.core import plugins
from litsim_sim.core.errors import EXIT_FAILED, InputError
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import Scenario, packaged, packaged_nets
from litsim_sim.scenario.signals import SignalsFile


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser("map", help="build or check a net", description=__doc__)
    what = command.add_mutually_exclusive_group()
    for name, source in _formats().items():
        what.add_argument(
            f"--{name}", type=Path, metavar=source.file, dest=_chosen(name), help=f"import {source.content}"
        )
    what.add_argument("--check", type=Path, metavar="NET.net.xml", help="check this net instead of building one")
    lights_help = "put traffic lights on this net: where --signals says, or as --recording shows who stops and starts"
    what.add_argument("--lights", type=Path, metavar="NET.net.xml", help=lights_help)
    command.add_argument("--signals", type=Path, metavar="S.yaml", help="for --lights: a file of signals with groups")
    command.add_argument("--recording", type=Path, metavar="R", help="recording to fit lanes to, or to check against")
    command.add_argument(
        "--origin",
        type=float,
        nargs=2,
        metavar=("LAT", "LON"),
        help="origin of frame map for --lanelet2; position of the site for --check",
    )
    scenario_help = "for --check, without --recording: a scenario, or its file, whose traffic to check against"
    command.add_argument("--scenario", action="append", default=[], metavar="S", help=scenario_help)
    picture_help = "for --check: draw the net, the tracks and where they lie on no lane; for --lights: what is proposed"
    command.add_argument("--picture", type=Path, metavar="P.png", help=picture_help)
    command.add_argument("--out", type=Path, metavar="OUT.net.xml", help="the net to write")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Builds or checks, and returns the exit status: 1 if a check misses its goal.

    Raises:
        InputError: the input cannot be used, or netconvert is missing.
    """
    if arguments.check is not None:
        return 0 if check(arguments) else EXIT_FAILED
    if arguments.out is None:
        raise InputError("data map: name the net to write with --out, or one to check with --check")
    print(f"building {arguments.out} ...", file=sys.stderr)
    for note in _build(arguments) if arguments.lights is None else _light(arguments):
        print(note, file=sys.stderr)
    return 0


def _build(arguments: argparse.Namespace) -> Sequence[str]:
    """Builds the net that `arguments` ask for, and returns lines on what of the map was not used, and on warnings.

    Raises:
        InputError: as :func:`run`.
    """
    from litsim_data.maps.carriageway import fit_carriageway
    from litsim_data.maps.net_builder import write_graph
    from litsim_data.maps.positions import positions_of

    out = arguments.out
    for name, source in _formats().items():
        if (path := getattr(arguments, _chosen(name))) is not None:
            return source().write_net(path, arguments.origin and tuple(arguments.origin), out)
    if arguments.recording is None:
        raise InputError("data map: name the recording to fit lanes to with --recording")
    return write_graph(fit_carriageway(positions_of(arguments.recording)), out).notes


def _light(arguments: argparse.Namespace) -> list[str]:
    """Puts traffic lights on a net, on the connections that a file names or a recording shows; returns lines on that.

    A proposal is written beside the net as a file of signals, and drawn where asked for.

    Raises:
        InputError: a file cannot be used, or the recording shows no lights.
    """
    from litsim_data.maps.lights import place_lights, propose_for

    net, out = arguments.lights, arguments.out
    if (arguments.signals is None) == (arguments.recording is None):
        raise InputError("data map --lights: name either a file of groups with --signals, or a recording to propose by")
    if arguments.signals is not None:
        return place_lights(net, read_yaml(arguments.signals, SignalsFile).groups, out, str(arguments.signals))
    proposal, notes = propose_for(net, arguments.recording, out)
    if arguments.picture is not None:
        from litsim_data.pictures.light_picture import draw_lights  # matplotlib takes half a second to load

        draw_lights(arguments.picture, LaneMap.from_net(net), proposal)
        notes.append(str(arguments.picture))
    return notes


def _formats() -> dict[str, type[MapFormat]]:
    """Returns the installed formats of maps, by name."""
    return {name: plugins.load(plugins.MAPS, name) for name in plugins.names(plugins.MAPS)}


def _chosen(name: str) -> str:
    """Returns where the arguments hold the map in the format `name`."""
    return f"map_{name}"


def check(arguments: argparse.Namespace) -> bool:
    """Checks a net, prints the result, draws it where asked for, and returns whether it meets the goals.

    Raises:
        InputError: a file cannot be used, or does not fit the net.
    """
    from litsim_data.maps.check import check_net
    from litsim_data.maps.check_text import describe

    net, packed = arguments.check, str(arguments.check).removesuffix(".net.xml")
    if not net.is_file() and packed in packaged_nets():
        net = packaged(f"nets/{packed}.net.xml")
    parts, transform = _parts(arguments)
    result = check_net(net, parts)
    print(describe(result, transform, None if arguments.origin is None else tuple(arguments.origin)))
    if arguments.picture is not None:
        from litsim_data.pictures.map_picture import draw  # matplotlib takes half a second to load

        draw(arguments.picture, LaneMap.from_net(net), parts, result)
        print(arguments.picture)
    return not result.failures


def _parts(arguments: argparse.Namespace) -> tuple[dict[str, pd.DataFrame], dict[str, Any] | None]:
    """Returns what is checked against the net, by name; and the transform by which the recording was mapped, if it was.

    Without a recording, scenarios are those of LitSim, whatever of them lies on their net.
    """
    from litsim_data.maps import positions

    if arguments.recording is None:
        loaded = [Scenario.load(name, coverage_min=0.0) for name in arguments.scenario]
        return {source.name: positions.vehicles_of(source.recording.table, source.name) for source in loaded}, None
    if arguments.scenario:
        raise InputError("data map: --scenario goes without --recording")
    recorded = {"recording": positions.positions_of(arguments.recording)}
    return recorded, positions.mapped_by(arguments.recording)
