"""`data synthesize`: generate recordings with SUMO, one to a file or a set with segments to a folder; compare them."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from litsim_data.description import describe
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.recording import Recording

NETS = ("us101_like", "urban_like")


def add(subparsers: Any) -> None:
    """Add the parser of the command."""
    command = subparsers.add_parser("synthesize", help="generate recordings with SUMO on a packaged net")
    command.add_argument("--net", choices=NETS, default=NETS[0], help="default %(default)s")
    command.add_argument("--seed", type=int, default=17, help="default %(default)s, that of us101_like.parquet")
    command.add_argument(
        "--seconds", type=float, default=28.1, help="length of a single recording [s]; default %(default)s"
    )
    segments = "generate N segments of 28 s, with manifest and scenario files, in a folder"
    command.add_argument("--segments", type=int, metavar="N", help=segments)
    command.add_argument("--out", type=Path, metavar="OUT", help="OUT.parquet, or the folder of the segments")
    command.add_argument(
        "--compare",
        action="store_true",
        help="write nothing; compare generated traffic, calibrated and with SUMO's defaults, with US-101",
    )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Generate, and print the result.

    Raises:
        InputError: the seed gives no usable traffic, `out` cannot be written, or the arguments do not fit each other.
    """
    if arguments.compare:
        from litsim_data.cli.calibrate import compare, data_folder

        if arguments.net != NETS[0]:
            raise InputError(f"--compare: complete real windows are known of US-101 only: use --net {NETS[0]}")
        print(compare(data_folder(None), arguments.seed))
        return
    if arguments.out is None:
        raise InputError("--out is missing: a file, or with --segments a folder")
    if arguments.segments is None:
        print(f"simulating {arguments.seconds:g} s after a warm-up ...", file=sys.stderr)
        print(describe(synthesize(arguments.seed, arguments.seconds, arguments.out, arguments.net)))
        return
    from litsim_data import segments
    from litsim_data.traffic.segment_set import write_segment_set

    began = time.perf_counter()
    print(f"simulating {arguments.segments} segments ...", file=sys.stderr)
    print(segments.describe(write_segment_set(arguments.net, arguments.segments, arguments.seed, arguments.out)))
    print(f"{time.perf_counter() - began:.1f} s", file=sys.stderr)


def synthesize(seed: int, seconds: float, out: Path, net: str = NETS[0]) -> Recording:
    """Generate a recording and write it to `out`.

    Raises:
        InputError: the seed gives no usable traffic, or `out` cannot be written.
    """
    from litsim_data.traffic.sites import SITES
    from litsim_data.traffic.synthetic import synthesize as generate

    recording = generate(seed, seconds, SITES[net])
    recording.write(out)
    return recording
