"""`data convert`: any known format to the neutral schema."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from litsim_sim.cli.recordings import describe
from litsim_sim.core.errors import InputError
from litsim_sim.recordings.load import load_recording
from litsim_sim.recordings.recording import Recording


def add(subparsers: Any) -> None:
    """Add the parser of the command."""
    command = subparsers.add_parser(
        "convert",
        help="any known format to the neutral schema",
        description="Convert a recording to the neutral schema. Official NGSIM files (recognised by content) are "
        "cleaned, and may hold several recordings: then OUT is a folder with one file each. An interrupted conversion "
        "of them is taken up by the same command.",
    )
    command.add_argument("source", type=Path, metavar="IN", help="recording of any known format")
    command.add_argument("out", type=Path, metavar="OUT", help="file OUT.parquet, or a folder for official NGSIM files")
    crop_help = "keep rows with COLUMN, as named in IN (NGSIM: as docs/data.md names them), from LOW through HIGH"
    command.add_argument("--crop", nargs=3, action="append", metavar=("COLUMN", "LOW", "HIGH"), help=crop_help)
    command.add_argument("--mapping", type=Path, metavar="M.yaml", help="IN is any CSV or Parquet, described by M.yaml")
    raw_help = "official NGSIM: keep published speeds and accelerations, do not smooth positions"
    command.add_argument("--raw", action="store_true", help=raw_help)
    truncated_help = "official NGSIM: accept a file that ends within a line"
    command.add_argument("--truncated", action="store_true", help=truncated_help)
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Convert and say what came out.

    Raises:
        InputError: IN cannot be used, `--crop` or the mapping do not fit it, or OUT cannot be written.
    """
    crop = parse_crop(arguments.crop)
    if arguments.mapping is not None:
        if crop or arguments.raw or arguments.truncated:
            raise InputError("--mapping goes with none of --crop, --raw, --truncated")
        from litsim_sim.recordings import generic

        recording = generic.convert(arguments.source, generic.read_mapping(arguments.mapping))
        recording.write(_file(arguments.out))
        print(describe(recording))
    elif _is_official(arguments.source):
        from litsim_sim.recordings.ngsim import official as ngsim

        options = {"cleaned": not arguments.raw, "truncated": arguments.truncated, "crop": crop}
        for made in ngsim.convert(arguments.source, arguments.out, progress=True, **options):
            print(made.text())
            if made.cleaning:
                print(made.cleaning)
    elif arguments.raw or arguments.truncated:
        raise InputError(f"{arguments.source}: --raw and --truncated are for official NGSIM files")
    else:
        print(describe(convert(arguments.source, arguments.out, crop)))


def convert(source: Path, out: Path, crop: dict[str, list[float]]) -> Recording:
    """Write the recording at `source`, cut by `crop`, in the neutral schema to `out`.

    Raises:
        InputError: `source` is no recording, `crop` does not fit it, or `out` cannot be written.
    """
    recording = load_recording(source, crop)
    recording.write(_file(out))
    return recording


def _file(out: Path) -> Path:
    if out.is_dir():
        raise InputError(f"{out}: is a folder, expected a file name such as {out / 'recording.parquet'}")
    return out


def _is_official(path: Path) -> bool:
    from litsim_sim.recordings.ngsim import formats as ngsim_format

    return path.is_file() and ngsim_format.detect(path) is not None


def parse_crop(pairs: list[list[str]] | None) -> dict[str, list[float]]:
    """The values of `--crop`, as they come from the command line.

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
