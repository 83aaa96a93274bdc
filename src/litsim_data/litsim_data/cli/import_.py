"""`data import`: data sets as they are published, to recordings, nets and scenarios in one command."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

from litsim_sim.cli.arguments import number
from litsim_sim.core.errors import EXIT_FAILED, InputError


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser(
        "import",
        help="a data set as it is published to a folder with recordings, nets and scenarios",
        description="Import a data set: formats are recognised by content. OUT gets, for each scene, a recording, its "
        "net and a picture of both; and a folder with scenarios.",
    )
    command.add_argument(
        "source", type=Path, metavar="SOURCE", help="a file of the data set, or a folder of such files"
    )
    command.add_argument("out", type=Path, metavar="OUT", help="the folder to write")
    command.add_argument("--map", type=Path, metavar="FILE", help="the map, where it is not in the data or beside")
    command.add_argument("--scenes", type=number(1), metavar="N", help="import only the first N scenes")
    command.add_argument("--raw", action="store_true", help="keep the motion of vehicles even where it is noisy")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Imports, and prints the result; returns the exit status: 1 if a scene could not be used, or gave no scenario.

    Raises:
        InputError: nothing of SOURCE could be used, or OUT cannot be written.
    """
    from litsim_data.sources.importing import HEAD, cut, import_all
    from litsim_sim.scenario.scenario import Sources
    from litsim_sim.scenario.usability import describe, survey

    if arguments.out.exists() and not (arguments.out.is_dir() and not any(arguments.out.iterdir())):
        raise InputError(f"{arguments.out}: exists already, expected a new folder: nothing is replaced")
    most = None if arguments.scenes is None else int(arguments.scenes)
    imported, failed = [], []
    for scene in import_all(arguments.source, arguments.out, arguments.map, most, raw=arguments.raw):
        if isinstance(scene, str):
            failed.append(scene)
            print(f"not used: {scene}", file=sys.stderr)
        else:
            imported.append(scene)
            print(*scene.lines, "", sep="\n", flush=True)
    if not imported:
        raise InputError(failed[0])
    folder = arguments.out / "scenarios"
    print(HEAD, *(scene.row for scene in imported), sep="\n")
    try:
        manifest = cut(imported, folder)
    except InputError as error:
        print(f"no scenario: {error}", file=sys.stderr)
        return EXIT_FAILED
    sources = [Sources(one.recording, one.net.lane_map) for one in imported]
    names = [folder / f"{segment.name}.yaml" for segment in manifest.segments]
    usable = survey(names, [sources[segment.recording] for segment in manifest.segments])
    print(describe(usable))
    print(
        f"next: ./litsim evaluate --scenario {shlex.quote(str(folder))}/*_train_*.yaml --ego idm --policy replay litsim"
    )
    return EXIT_FAILED if failed or any(one.lacks for one in usable) else 0
