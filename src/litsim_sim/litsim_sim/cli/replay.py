"""`replay BAG`: publish a recorded run again as if live."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from litsim_sim.cli.arguments import Parser, number
from litsim_sim.cli.program import program


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_sim replay``."""
    p = Parser(prog="replay", description=__doc__)
    p.add_argument("bag", type=Path, metavar="BAG", help="folder of a run, or its MCAP file")
    p.add_argument("--rate", type=float, default=1.0, help="simulated seconds per second (default: 1)")
    p.add_argument("--start", type=float, default=0.0, metavar="S", help="time at which to begin [s]")
    p.add_argument("--loop", action="store_true", help="restart after the end")
    p.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="only these, and /clock")
    p.add_argument("--paused", action="store_true", help="wait for service ~/pause")
    p.add_argument(
        "--delay",
        type=number(0.0),
        default=1.0,
        metavar="S",
        help="time to discover subscribers before it begins [s] (default: 1)",
    )
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_sim replay``."""
    own, ros = split_arguments(sys.argv[1:] if argv is None else argv)
    arguments = parser().parse_args(own)
    from litsim_sim.nodes.replay import play  # --help is quick without ROS

    play(
        arguments.bag,
        ros,
        arguments.topics,
        arguments.delay,
        rate=arguments.rate,
        start_s=arguments.start,
        loop=arguments.loop,
        paused=arguments.paused,
    )


def split_arguments(argv: list[str]) -> tuple[list[str], list[str]]:
    """Split the command line into own arguments and those of ROS."""
    end = argv.index("--ros-args") if "--ros-args" in argv else len(argv)
    return argv[:end], argv[end:]
