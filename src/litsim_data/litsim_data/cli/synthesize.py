"""`data synthesize`: generate recordings with SUMO, one to a file or a set with segments to a folder."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from litsim_data.generic.description import describe

NETS = ("us101_like", "urban_like")


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser("synthesize", help="generate recordings with SUMO on a packaged net")
    command.add_argument("--net", choices=NETS, default=NETS[0], help="default %(default)s")
    command.add_argument("--seed", type=int, default=17, help="default %(default)s, the seed of us101_like.parquet")
    command.add_argument(
        "--seconds", type=float, default=28.1, help="length of a single recording [s]; default %(default)s"
    )
    segments = "generate N segments of 28 s, with manifest and scenario files, in a folder"
    command.add_argument("--segments", type=int, metavar="N", help=segments)
    command.add_argument(
        "--out", type=Path, required=True, metavar="OUT", help="OUT.parquet, or the folder of the segments"
    )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Generates, and prints the result.

    Raises:
        InputError: the seed gives no usable traffic, or OUT cannot be written.
    """
    began = time.perf_counter()
    if arguments.segments is None:
        from litsim_data.traffic.sites import SITES
        from litsim_data.traffic.synthetic import synthesize

        print(f"simulating {arguments.seconds:g} s after a warm-up ...", file=sys.stderr)
        recording = synthesize(arguments.seed, arguments.seconds, SITES[arguments.net])
        recording.write(arguments.out)
        print(describe(recording))
        return
    from litsim_data import segments
    from litsim_data.traffic.segment_set import write_segment_set

    print(f"simulating {arguments.segments} segments ...", file=sys.stderr)
    print(segments.describe(write_segment_set(arguments.net, arguments.segments, arguments.seed, arguments.out)))
    print(f"{time.perf_counter() - began:.1f} s", file=sys.stderr)
