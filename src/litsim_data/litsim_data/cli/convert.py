"""`data convert`: any known format to the neutral schema."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from litsim_data.generic.description import describe
from litsim_data.ngsim.formats import is_official
from litsim_data.sources.autoware_bag import bag_file
from litsim_data.sources.source import Scene, Source, source_of
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import refuse_input_as_output, replacing
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording

if TYPE_CHECKING:
    from litsim_data.generic.mapping import Mapping


NOT_DRAFTED = ("mapping", "vehicles", "clip", "crop", "raw", "net")  # options that do not apply to a draft


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser(
        "convert",
        help="any known format to the neutral schema",
        description="Convert a recording to the neutral schema. Official NGSIM files (recognised by content) are "
        "cleaned, and may hold several recordings: then OUT is a folder with one file each.",
    )
    source_help = "recording of any known format; with --mapping or --draft, several files make one table"
    command.add_argument("sources", type=Path, nargs="+", metavar="IN", help=source_help)
    command.add_argument("out", type=Path, metavar="OUT", help="file OUT.parquet, or a folder for official NGSIM files")
    crop_help = "keep rows with LOW <= COLUMN <= HIGH, with COLUMN as named in IN (NGSIM: in docs/data.md)"
    command.add_argument("--crop", nargs=3, action="append", metavar=("COLUMN", "LOW", "HIGH"), help=crop_help)
    command.add_argument("--mapping", type=Path, metavar="M.yaml", help="IN is any CSV or Parquet, described by M.yaml")
    command.add_argument("--clip", metavar="CLIP", help="with --mapping: which of several clips in IN")
    vehicles_help = "with --mapping: the file of its field vehicles"
    command.add_argument("--vehicles", type=Path, metavar="FILE", help=vehicles_help)
    draft_help = "guess a mapping (YAML) for IN from its columns, and write it to OUT for you to check"
    command.add_argument("--draft", action="store_true", help=draft_help)
    net_help = "cut tracks to where lanes of this net are (a file, or the name of a packaged one)"
    command.add_argument("--net", metavar="NET", help=net_help)
    raw_help = "official NGSIM, and with --mapping: keep speeds and accelerations of the file, do not smooth positions"
    command.add_argument("--raw", action="store_true", help=raw_help)
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Converts, and prints the result.

    Raises:
        InputError: IN cannot be used, `--crop` or the mapping do not fit it, or OUT cannot be written.
    """
    crop = parse_crop(arguments.crop)
    refuse_input_as_output(arguments.out, *arguments.sources, *filter(None, [arguments.mapping, arguments.vehicles]))
    source = bag_file(arguments.sources[0])
    if arguments.draft:
        _draft(arguments)
        return
    if arguments.mapping is not None:
        _convert_mapped(arguments, crop)
        return
    for option in ("clip", "vehicles"):
        if getattr(arguments, option) is not None:
            raise InputError(f"--{option} goes with --mapping")
    if len(arguments.sources) > 1:
        raise InputError(f"{arguments.sources[1]}: several files IN go with --mapping or --draft")
    if is_official(source):
        if arguments.net is not None:
            raise InputError(
                f"{source}: --net does not go with official NGSIM files: convert them, then cut the result"
            )
        from litsim_data.ngsim.official import convert

        for one in convert(source, arguments.out, cleaned=not arguments.raw, crop=crop):
            print(f"{one.name}: {one.vehicles} vehicles -> {one.path}")
            print(one.counts.text())
        return
    if arguments.raw:
        raise InputError(f"{source}: --raw is for official NGSIM files, and for --mapping")
    if not crop and arguments.net is None and (known := source_of(source)) is not None:
        _convert_scene(next(known.read(source, None)), known, arguments.out, raw=False)
        return
    recording, cut = _cut(load_recording(source, crop), arguments)
    recording.write(_file(arguments.out))
    print(describe(recording), *cut, sep="\n")


def _cut(recording: Recording, arguments: argparse.Namespace) -> tuple[Recording, list[str]]:
    """Returns the recording, cut to the net that `--net` names, and lines on what was left out.

    Raises:
        InputError: there is no such net, or no vehicle comes onto its lanes.
    """
    if arguments.net is None:
        return recording, []
    from litsim_data.maps.net_cropping import cropped_to_net
    from litsim_sim.lane_map.lane_map import LaneMap
    from litsim_sim.scenario.recorded_net import net_of

    net = net_of(recording.header, arguments.out, arguments.net)
    cut, lines = cropped_to_net(recording, LaneMap.from_net(net))
    if not len(cut.columns["frame"]):
        raise InputError(f"{arguments.sources[0]}: no vehicle comes onto a lane of {net}: data map --check shows why")
    return cut, lines


def _convert_scene(scene: Scene, source: Source, out: Path, *, raw: bool) -> None:
    """Converts the tracks of a scene; changes of traffic lights become a file beside the recording."""
    from litsim_data.sources.importing import converted

    recording, counts = converted(scene, source, raw=raw)
    recording.write(_file(out))
    print(describe(recording), counts.text(), *(f"note       {note}" for note in scene.notes), sep="\n")
    if scene.signals:
        changes = out.with_name(f"{out.stem}_signals.csv")
        with replacing(changes) as new:
            pd.DataFrame(scene.signals, columns=["begin", "group", "state"]).to_csv(new, index=False)
        print(f"{'signals':<11}{len(scene.signals)} changes -> {changes}")


def _convert_mapped(arguments: argparse.Namespace, crop: dict[str, list[float]]) -> None:
    from litsim_data.generic.convert import convert
    from litsim_data.generic.mapping import Mapping, Span

    mapping = read_yaml(arguments.mapping, Mapping)
    rows = mapping.rows | {column: Span(min=low, max=high) for column, (low, high) in crop.items()}
    clip = mapping.clip if arguments.clip is None else arguments.clip
    if clip is not None and mapping.columns.clip is None:
        raise InputError(f"{arguments.mapping}: a clip is chosen, but field columns.clip does not say where clips are")
    chosen: dict[str, Any] = {"rows": rows, "clip": clip} | ({"clean": False} if arguments.raw else {})
    if arguments.vehicles is not None:
        if mapping.vehicles is None:
            raise InputError(f"{arguments.mapping}: --vehicles is given, but field vehicles does not say what is in it")
        file = os.path.relpath(arguments.vehicles, arguments.sources[0].parent)
        chosen["vehicles"] = mapping.vehicles.model_copy(update={"file": file})
    recording, counts = convert(arguments.sources, mapping.model_copy(update=chosen))
    recording, cut = _cut(recording, arguments)
    recording, signals = _with_signals(recording, mapping, arguments.mapping, arguments.out)
    recording.write(_file(arguments.out))
    print(describe(recording), counts.text(), *cut, *signals, sep="\n")


def _with_signals(recording: Recording, mapping: Mapping, file: Path, out: Path) -> tuple[Recording, list[str]]:
    """Returns the recording with the signals that the mapping in `file` names, and lines on how vehicles heed them.

    Frames of a file of states are those of the table, where it counts frames, and else those of the recording.

    Raises:
        InputError: the signals cannot be used, do not fit the net, or are not what vehicles heed; or there is no net.
    """
    if not mapping.signals:
        return recording, []
    from litsim_data.generic.convert import CLOCK
    from litsim_sim.scenario.recorded_net import net_of
    from litsim_sim.scenario.recorded_signals import survey
    from litsim_sim.scenario.signals import SignalsFile, on_clock, resolved

    path = file.parent / mapping.signals
    signals = read_yaml(path, SignalsFile)
    by_frame = signals.states is not None and signals.states.unit == "frame"
    zero = 0.0 if by_frame else float(str(recording.header.notes.get(CLOCK, 0.0)))
    slower = recording.header.rate_hz / mapping.rate_hz if by_frame and mapping.columns.frame is not None else 1.0
    content = on_clock(resolved(signals, path.parent, str(path)), zero, slower)
    net = net_of(recording.header, out)
    lines = survey(content, net, recording, str(path))
    header = replace(recording.header, net=net.name, signals=content.model_dump(mode="json", exclude_none=True))
    return Recording(header, recording.columns), lines


def _draft(arguments: argparse.Namespace) -> None:
    from litsim_data.generic.draft import draft

    options = [f"--{name}" for name in NOT_DRAFTED if getattr(arguments, name) not in (None, False)]
    if options:
        raise InputError(
            f"--draft goes without {', '.join(options)}: it reads IN alone; fields vehicles, clip"
            " and rows of the mapping that it writes say the rest"
        )
    out = _file(arguments.out)
    if out.exists():
        raise InputError(f"{out}: exists already; --draft does not overwrite")
    text = draft(arguments.sources)
    with replacing(out) as new:
        new.write_text(text, encoding="utf-8")
    print(text, end="")
    files = " ".join(map(str, arguments.sources))
    print(f"look it over, above all what is marked: data convert --mapping {out} {files} OUT.parquet")


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
