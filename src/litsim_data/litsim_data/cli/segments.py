"""`data segments`: cut recordings into segments with an ego each; a manifest and a scenario file for every segment."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from litsim_data import segments
from litsim_data.cli.import_ import parse_crop
from litsim_sim.core.errors import EXIT_FAILED, InputError
from litsim_sim.io.files import relative
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recorded_net import net_named, net_of
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import DATA_VARIABLE, Sources, packaged, packaged_nets
from litsim_sim.scenario.scenario_file import usable_name
from litsim_sim.scenario.usability import Usability, describe, survey


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser("segments", help="cut recordings into scenarios of 28 s, split 70/10/20")
    command.add_argument("recordings", nargs="*", type=Path, metavar="RECORDING", help="of any known format")
    command.add_argument("--manifest", type=Path, help="instead: reproduce this manifest and its scenario files")
    command.add_argument("--out", type=Path, required=True, metavar="DIR")
    command.add_argument("--net", help="packaged net or file; default: the net that the recording names")
    command.add_argument("--crop", nargs=3, action="append", metavar=("COLUMN", "LOW", "HIGH"), help="as for convert")
    defaults = segments.Settings()
    command.add_argument(
        "--seed", type=int, default=defaults.seed, help="seed of the choice of egos; default %(default)s"
    )
    for name, text in (
        ("history", "recorded past [s]"),
        ("simulation", "simulated time after the history [s]"),
        ("stride", "time from the start of a segment to the start of the next [s]"),
        ("ego-min", "least time that an ego is present after the history [s]"),
    ):
        value = getattr(defaults, f"{name.replace('-', '_')}_s")
        command.add_argument(f"--{name}", type=float, default=value, help=f"{text}; default %(default)s")
    split = [f"{share:g}" for share in defaults.split]
    shares = f"shares of time for train, val and test; default {' '.join(split)}"
    command.add_argument("--split", type=float, nargs=3, default=list(defaults.split), help=shares)
    coverage = "share of box centres that must lie on lanes in the scenarios; default: that of scenarios"
    command.add_argument("--coverage-min", type=float, metavar="SHARE", help=coverage)
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Cuts, writes and prints the result, and returns the exit status: 1 if none of the scenarios can be loaded.

    Raises:
        InputError: a recording, its net or OUT cannot be used, or the arguments do not fit each other.
    """
    if bool(arguments.recordings) == bool(arguments.manifest):
        raise InputError("expected either recordings or --manifest")
    if arguments.manifest:
        manifest, recordings = _reproduce(arguments.manifest, arguments.out)
    else:
        crop = parse_crop(arguments.crop)
        try:
            settings = segments.Settings(
                seed=arguments.seed,
                history_s=arguments.history,
                simulation_s=arguments.simulation,
                stride_s=arguments.stride,
                ego_min_s=arguments.ego_min,
                split=tuple(arguments.split),
                coverage_min=arguments.coverage_min,
            )
        except ValidationError as error:
            problem = error.errors()[0]
            raise InputError(f"{'.'.join(map(str, problem['loc']))} is {problem['input']}: {problem['msg']}") from error
        manifest, recordings = _cut_files(arguments.recordings, arguments.out, arguments.net, crop or None, settings)
    usability = _usability(manifest, arguments.out, recordings)
    print(segments.describe(manifest))
    print(describe(usability))
    return EXIT_FAILED if all(scenario.lacks for scenario in usability) else 0


def _cut_files(
    paths: list[Path], out: Path, net: str | None, crop: dict[str, list[float]] | None, settings: segments.Settings
) -> tuple[segments.Manifest, list[Recording]]:
    """Cuts the recordings at `paths`, and returns the manifest and the cropped recordings; see :func:`run`."""
    for path in paths:
        try:
            usable_name(segments.name_of(path.name, "train", 0))
        except ValueError as error:
            raise InputError(f"{path}: scenarios are named after the file: {error}; rename it") from error
    sources = []
    for path in paths:
        recording = load_recording(path, crop)
        sources.append((_stored(path, out), _net(net_of(recording.header, path, net), out), crop, recording))
    manifest = segments.cut(sources, settings)
    segments.write(manifest, out)
    return manifest, [recording for *_, recording in sources]


def _reproduce(path: Path, out: Path) -> tuple[segments.Manifest, list[Recording]]:
    """Cuts again by the manifest at `path`, writes to `out`, and returns the same as :func:`_cut_files`."""
    manifest = segments.Manifest.read(path)
    again, cropped = segments.reproduce(manifest, path.parent)
    if again != manifest:
        raise InputError(f"{path}: its recordings and settings give other segments than it lists: was it edited?")

    def moved(name: str, *, stays: bool) -> str:
        return name if stays else _stored(path.parent / name, out)

    recordings = [
        source.model_copy(
            update={
                "file": moved(source.file, stays=source.file.startswith("$")),
                "net": moved(source.net, stays=source.net in packaged_nets()),
            }
        )
        for source in again.recordings
    ]
    again = again.model_copy(update={"recordings": recordings})
    segments.write(again, out)
    return again, cropped


def _stored(path: Path, folder: Path) -> str:
    """Returns `path` as the manifest in `folder` has it: relative to $LITSIM_DATA if below it, else to the folder."""
    data = os.environ.get(DATA_VARIABLE)
    if data and path.resolve().is_relative_to(Path(data).resolve()):
        return f"${{{DATA_VARIABLE}}}/{path.resolve().relative_to(Path(data).resolve()).as_posix()}"
    return relative(path, folder)


def _net(net: Path, out: Path) -> str:
    """Returns the name of the packaged net, or the path of the net relative to `out`."""
    if net.parent == packaged("nets"):
        return net.name.removesuffix(".net.xml")
    return relative(net, out)


def _usability(manifest: segments.Manifest, out: Path, recordings: list[Recording]) -> list[Usability]:
    """Returns which of the scenarios that lie in `out` can be loaded; `recordings` are those of the manifest."""
    nets = [net_named(source.net, out) for source in manifest.recordings]
    lane_maps = {net: LaneMap.from_net(net) for net in nets}
    sources = [Sources(recording, lane_maps[net]) for recording, net in zip(recordings, nets, strict=True)]
    paths = [out / f"{segment.name}.yaml" for segment in manifest.segments]
    return survey(paths, [sources[segment.recording] for segment in manifest.segments])
