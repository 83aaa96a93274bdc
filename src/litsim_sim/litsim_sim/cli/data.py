"""`data`: look at recordings, convert and generate them, build nets, list what is packaged."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import yaml

from litsim_sim.datasets import load_recording, ngsim_windows
from litsim_sim.errors import InputError
from litsim_sim.recording import STEP_S, Kind, Recording
from litsim_sim.scenario import DATA_VARIABLE, packaged, packaged_nets, packaged_scenarios

US101_FILE = "ngsim/us101_0750_frames_0126_1149.parquet"


def info(path: Path) -> str:
    """What a recording holds, as text.

    Raises:
        InputError: `path` is no recording.
    """
    return _describe(load_recording(path))


def convert(source: Path, out: Path, crop: dict[str, list[float]]) -> Recording:
    """Write the recording at `source`, cut by `crop`, in the neutral schema to `out`.

    Raises:
        InputError: `source` is no recording, `crop` does not fit it, or `out` cannot be written.
    """
    recording = load_recording(source, crop)
    _write(recording, out)
    return recording


def synthesize(seed: int, seconds: float, out: Path) -> Recording:
    """Generate a recording and write it to `out`.

    Raises:
        InputError: the seed gives no usable traffic, or `out` cannot be written.
    """
    from litsim_sim.datasets.synthetic import synthesize as generate

    recording = generate(seed, seconds)
    _write(recording, out)
    return recording


def build_map(which: str, out: Path, recording: Path | None) -> None:
    """Build a net: `us101_like`, or `us101` fitted to the windows file at `recording`.

    Raises:
        InputError: netconvert or the recording is missing, or `out` cannot be written.
    """
    from litsim_sim.maps.fitting import fit_us101_plan
    from litsim_sim.maps.highway import us101_like_plan, write_net

    plan = us101_like_plan() if which == "us101_like" else fit_us101_plan(ngsim_windows.read_table(_us101(recording)))
    try:
        write_net(plan, out)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from error


def listing() -> str:
    """Packaged scenarios and nets, as text."""
    lines = ["scenarios:"]
    for name in packaged_scenarios():
        fields = yaml.safe_load(packaged(f"scenarios/{name}.yaml").read_text(encoding="utf-8"))
        lines.append(f"  {name:<16}{fields['description']}")
    lines.append("nets:")
    lines += [f"  {name:<16}{packaged(f'nets/{name}.net.xml')}" for name in packaged_nets()]
    return "\n".join(lines)


def _describe(recording: Recording) -> str:
    header, table = recording.header, recording.table
    vehicles = table.drop_duplicates("vehicle_id")
    per_frame = table.groupby("frame").size()
    kinds = {kind.name.lower(): int((vehicles["kind"] == kind).sum()) for kind in Kind}
    first, last = int(table["frame"].min()), int(table["frame"].max())
    span = ", ".join(f"{axis} {table[axis].min():.1f} to {table[axis].max():.1f} m" for axis in ("x", "y"))
    rows = {
        "name": header.name,
        "source": header.source,
        "licence": header.licence,
        "net": header.net,
        "frames": f"{first} to {last} ({(last - first) * STEP_S:.1f} s at {header.rate_hz:g} Hz), {len(table)} rows",
        "vehicles": f"{len(vehicles)} ({', '.join(f'{count} {kind}' for kind, count in kinds.items() if count)})",
        "at a time": f"{per_frame.min()} to {per_frame.max()}, mean {per_frame.mean():.1f}",
        "speed": f"mean {table['speed'].mean():.1f}, {table['speed'].min():.1f} to {table['speed'].max():.1f} m/s",
        "extent": span,
        "notes": ", ".join(f"{key}: {value}" for key, value in header.notes.items()),
    }
    return "\n".join(f"{name:<11}{value}" for name, value in rows.items() if value)


def _write(recording: Recording, out: Path) -> None:
    try:
        recording.write(out)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from error


def _us101(recording: Path | None) -> Path:
    """The windows file: as given, or where the development data lies."""
    if recording is not None:
        return recording
    data = os.environ.get(DATA_VARIABLE)
    if not data:
        raise InputError(f"net us101 is fitted to real tracks: name them with --recording, or set {DATA_VARIABLE}")
    return Path(data) / US101_FILE


def _crop(pairs: list[list[str]] | None) -> dict[str, list[float]]:
    crop: dict[str, list[float]] = {}
    for column, low, high in pairs or []:
        try:
            crop[column] = [float(low), float(high)]
        except ValueError as error:
            raise InputError(f"--crop {column} {low} {high}: expected a column and two numbers") from error
    return crop


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="data", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    command = commands.add_parser("list", help="packaged scenarios and nets")

    command = commands.add_parser("info", help="what a recording holds")
    command.add_argument("file", type=Path, help="recording of any known format")

    command = commands.add_parser("convert", help="any known format to the neutral schema")
    command.add_argument("source", type=Path, metavar="IN", help="recording of any known format")
    command.add_argument("out", type=Path, metavar="OUT.parquet")
    crop_help = "keep rows with COLUMN, as named in IN, from LOW through HIGH; may be repeated"
    command.add_argument("--crop", nargs=3, action="append", metavar=("COLUMN", "LOW", "HIGH"), help=crop_help)

    command = commands.add_parser("synthesize", help="generate a recording with SUMO on net us101_like")
    command.add_argument("--seed", type=int, default=3, help="default %(default)s, that of scenario demo")
    command.add_argument("--seconds", type=float, default=28.1, help="duration; default %(default)s")
    command.add_argument("--out", type=Path, required=True, metavar="OUT.parquet")

    command = commands.add_parser("map", help="build a net with netconvert")
    command.add_argument("--which", choices=("us101_like", "us101"), required=True)
    command.add_argument("--recording", type=Path, help=f"for us101; default ${DATA_VARIABLE}/{US101_FILE}")
    command.add_argument("--out", type=Path, required=True, metavar="OUT.net.xml")
    return parser


def _run(arguments: argparse.Namespace) -> None:
    if arguments.command == "list":
        print(listing())
    elif arguments.command == "info":
        print(info(arguments.file))
    elif arguments.command == "convert":
        print(_describe(convert(arguments.source, arguments.out, _crop(arguments.crop))))
    elif arguments.command == "synthesize":
        print(f"simulating {arguments.seconds:g} s after a warm-up ...", file=sys.stderr)
        print(_describe(synthesize(arguments.seed, arguments.seconds, arguments.out)))
    else:
        print(f"building {arguments.out} ...", file=sys.stderr)
        build_map(arguments.which, arguments.out, arguments.recording)


def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_sim data``."""
    arguments = _parser().parse_args(argv)
    try:
        _run(arguments)
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
