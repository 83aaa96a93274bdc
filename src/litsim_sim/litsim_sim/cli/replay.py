"""`replay BAG`: publish a recorded run again as if live, or repair its bag."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from litsim_sim.cli.arguments import Parser, number
from litsim_sim.cli.program import program

KEYS = "While it plays in a terminal: space pauses, s steps, arrows seek 1 s (paused: one step), + - rate, q quits."


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_sim replay``."""
    p = Parser(prog="replay", description=__doc__, epilog=KEYS)
    p.add_argument("bag", type=Path, metavar="BAG", help="folder of a run, or its MCAP file")
    playing = p.add_argument_group("publish its topics and /clock")
    playing.add_argument("--rate", type=float, default=1.0, help="simulated seconds per second (default: 1)")
    playing.add_argument("--start", type=float, default=0.0, metavar="S", help="time at which to begin [s]")
    playing.add_argument("--loop", action="store_true", help="restart after the end")
    playing.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="only these, and /clock")
    playing.add_argument("--paused", action="store_true", help="wait for space, s, or the services ~/pause and ~/step")
    playing.add_argument(
        "--delay",
        type=number(0.0),
        default=1.0,
        metavar="S",
        help="time to discover subscribers before it begins [s] (default: 1)",
    )
    other = p.add_argument_group("instead of playing")
    other.add_argument(
        "--repair", action="store_true", help="make a complete bag from one that was cut short; needs --out"
    )
    other.add_argument("--out", type=Path, metavar="FOLDER", help="where --repair writes the new bag")
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_sim replay``."""
    own, ros = split_arguments(sys.argv[1:] if argv is None else argv)
    p = parser()
    arguments = p.parse_args(own)
    if arguments.repair != (arguments.out is not None):
        p.error("--repair and --out go together")
    if arguments.repair:
        _repair(arguments.bag, arguments.out)
        return
    from litsim_sim.nodes.replay import play  # repairs need no graph

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


def _repair(bag: Path, out: Path) -> None:
    from litsim_sim.record.repair import repair

    repaired = repair(bag, out)
    print(f"{repaired.path}: {repaired.messages.total()} messages on {len(repaired.messages)} topics", end="")
    print(f", attachments {', '.join(repaired.attachments) or 'none'}")
    for loss in repaired.lost or ["nothing: the bag was complete"]:
        print(f"lost: {loss}")


def split_arguments(argv: list[str]) -> tuple[list[str], list[str]]:
    """Split the command line into own arguments and those of ROS."""
    at = argv.index("--ros-args") if "--ros-args" in argv else len(argv)
    return argv[:at], argv[at:]
