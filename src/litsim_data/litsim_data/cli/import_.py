"""`data import`: recordings as they are published to LitSim's own, with nets and scenarios where there is a map."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from litsim_data.generic.mapping import Check, Mapping
from litsim_sim.cli.arguments import number
from litsim_sim.core.errors import EXIT_FAILED, InputError
from litsim_sim.core.installation import command
from litsim_sim.io.files import refuse_input_as_output, require_new_folder, write_text
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.recorded_net import NET_ENDINGS, net_named

if TYPE_CHECKING:
    from litsim_data.sources.importing import Imported, Options
    from litsim_data.sources.source import Source

NOT_DRAFTED = ("mapping", "vehicles", "clip", "crop", "raw", "map", "scenes", "accept")  # options not of a draft


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser(
        "import",
        aliases=["convert"],
        help="recordings of any known format, or tables by a mapping, to LitSim's own, with nets and scenarios",
        description="Import recordings: formats are recognised by content, and any table is described by a mapping. "
        "All pass the same checks, and the fate of their rows is printed. OUT.parquet gets the recording alone; a "
        "folder OUT, for each scene, a recording, and where there is a map its net, a picture of both, and scenarios.",
    )
    source_help = "a file, or a folder of such files or of a bag; with --mapping or --draft several files are one table"
    command.add_argument("sources", type=Path, nargs="+", metavar="IN", help=source_help)
    command.add_argument("out", type=Path, metavar="OUT", help="a file OUT.parquet, or a new folder")
    map_help = "the map, where it is not in the data or beside: a file, or a packaged net; tracks are cut to its lanes"
    command.add_argument("--map", "--net", dest="map", metavar="FILE", help=map_help)
    command.add_argument("--scenes", type=number(1), metavar="N", help="import only the first N scenes")
    crop_help = "keep rows with LOW <= COLUMN <= HIGH, with COLUMN as named in IN (NGSIM: in docs/data.md)"
    command.add_argument("--crop", nargs=3, action="append", metavar=("COLUMN", "LOW", "HIGH"), help=crop_help)
    command.add_argument("--raw", action="store_true", help="keep the motion of vehicles even where it is noisy")
    accept_help = "skip a check of the motion, where the file is right"
    command.add_argument("--accept", action="append", default=[], choices=get_args(Check), help=accept_help)
    command.add_argument("--mapping", type=Path, metavar="M.yaml", help="IN is any CSV or Parquet, described by M.yaml")
    command.add_argument("--clip", metavar="CLIP", help="with --mapping: which of several clips in IN")
    vehicles_help = "with --mapping: the file of its field vehicles"
    command.add_argument("--vehicles", type=Path, metavar="FILE", help=vehicles_help)
    draft_help = "guess a mapping (YAML) for IN from its columns, and write it to OUT for you to check"
    command.add_argument("--draft", action="store_true", help=draft_help)
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Imports, and prints the result; returns the exit status: 1 if a scene could not be used, or gave no scenario.

    Raises:
        InputError: nothing of IN could be used, options do not fit it, or OUT cannot be written.
    """
    refuse_input_as_output(arguments.out, *arguments.sources, *filter(None, [arguments.mapping, arguments.vehicles]))
    if arguments.draft:
        _draft(arguments)
        return 0
    from litsim_data.sources.importing import Options, files_of, import_alone

    crop, net = parse_crop(arguments.crop), arguments.map
    lanes = None if net is None else net_named(net)
    options = Options(lanes, crop, arguments.raw, arguments.accept)
    files = _mapped(arguments) or [part for path in arguments.sources for part in files_of(path)]
    if arguments.out.suffix != ".parquet":
        return _import_all(arguments, files, options)
    if lanes is not None and not lanes.name.endswith(NET_ENDINGS):
        raise InputError(f"{lanes}: a recording alone is cut to a net: OUT is a folder where the net is built of a map")
    scenes = ((scene, source) for file, source in files for scene in source.scenes(file, lanes, crop))
    (scene, source), other = next(scenes), next(scenes, None)
    if other is not None:
        raise InputError(f"{arguments.out}: IN holds several recordings, such as {scene.name}: expected a folder OUT")
    print(*import_alone(scene, source, _file(arguments.out), options), sep="\n")
    return 0


def _mapped(arguments: argparse.Namespace) -> list[tuple[Path, Source]]:
    """Returns the files as a table by the mapping that is given, with the options that say more; empty without one."""
    from litsim_data.sources.table import MappedTable

    if arguments.mapping is None:
        for option in ("clip", "vehicles"):
            if getattr(arguments, option) is not None:
                raise InputError(f"--{option} goes with --mapping")
        return []
    mapping, chosen = read_yaml(arguments.mapping, Mapping), dict[str, Any]()
    if arguments.clip is not None:
        chosen["clip"] = arguments.clip
    if {**mapping.model_dump(), **chosen}["clip"] is not None and mapping.columns.clip is None:
        raise InputError(f"{arguments.mapping}: a clip is chosen, but field columns.clip does not say where clips are")
    if arguments.vehicles is not None:
        if mapping.vehicles is None:
            raise InputError(f"{arguments.mapping}: --vehicles is given, but field vehicles does not say what is in it")
        file = os.path.relpath(arguments.vehicles, arguments.sources[0].parent)
        chosen["vehicles"] = mapping.vehicles.model_copy(update={"file": file})
    first, *more = arguments.sources
    return [(first, MappedTable(mapping.model_copy(update=chosen), arguments.mapping, more))]


def _import_all(arguments: argparse.Namespace, files: Sequence[tuple[Path, Source]], options: Options) -> int:
    """Imports all scenes into a folder, and scenarios that are cut from them; see :func:`run`."""
    from litsim_data.sources.importing import HEAD, import_all

    require_new_folder(arguments.out)
    most = None if arguments.scenes is None else int(arguments.scenes)
    imported: list[Imported] = []
    failed: list[str] = []
    for scene in import_all(files, arguments.out, options, most):
        if isinstance(scene, str):
            failed.append(scene)
            print(f"not used: {scene}", file=sys.stderr)
        else:
            imported.append(scene)
            print(*scene.lines, "", sep="\n", flush=True)
    if not imported:
        with suppress(OSError):  # it holds a net
            arguments.out.rmdir()
        raise InputError(failed[0])
    print(HEAD, *(scene.row for scene in imported), sep="\n")
    on_net = [scene for scene in imported if scene.net is not None]
    if not on_net:
        print("no scenarios: there is no map: --map names one")
        return EXIT_FAILED if failed else 0
    return EXIT_FAILED if not _cut(on_net, arguments.out / "scenarios") or failed else 0


def _cut(imported: list[Imported], folder: Path) -> bool:
    """Cuts scenarios, and prints them; returns whether all can be used."""
    from litsim_data.sources.importing import cut
    from litsim_sim.scenario.scenario import Sources
    from litsim_sim.scenario.usability import describe, survey

    try:
        manifest = cut(imported, folder)
    except InputError as error:
        print(f"no scenario: {error}", file=sys.stderr)
        return False
    sources = [Sources(part.recording, part.net.lane_map) for part in imported if part.net is not None]
    names = [folder / f"{segment.name}.yaml" for segment in manifest.segments]
    usable = survey(names, [sources[segment.recording] for segment in manifest.segments])
    print(describe(usable))
    scenarios = f"{shlex.quote(str(folder))}/*_train_*.yaml"
    print(f"next: {command()} evaluate --scenario {scenarios} --ego idm --policy replay litsim")
    return not any(result.lacks for result in usable)


def _draft(arguments: argparse.Namespace) -> None:
    from litsim_data.generic.draft import draft

    options = [f"--{name}" for name in NOT_DRAFTED if getattr(arguments, name) not in (None, False, [])]
    if options:
        raise InputError(
            f"--draft goes without {', '.join(options)}: it reads IN alone; fields vehicles, clip"
            " and rows of the mapping that it writes say the rest"
        )
    out = _file(arguments.out)
    if out.exists():
        raise InputError(f"{out}: exists already; --draft does not overwrite")
    text = draft(arguments.sources)
    write_text(out, text)
    print(text, end="")
    files = " ".join(map(str, arguments.sources))
    print(f"look it over, above all what is marked: data import --mapping {out} {files} OUT.parquet")


def _file(out: Path) -> Path:
    if out.is_dir():
        raise InputError(f"{out}: is a folder, expected a file name such as {out / 'recording.parquet'}")
    return out


def parse_crop(pairs: list[list[str]] | None) -> dict[str, list[float]]:
    """Returns the limits that `--crop` gives, by column.

    Raises:
        InputError: limits are no numbers.
    """
    crop: dict[str, list[float]] = {}
    for column, low, high in pairs or []:
        try:
            crop[column] = [float(low), float(high)]
        except ValueError as error:
            raise InputError(f"--crop {column} {low} {high}: expected a column and two numbers") from error
    return crop
