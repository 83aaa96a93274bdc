"""`replay BAG`: publish a recorded run again as if live; or repair it, or re-run one of its stages or all of it."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import NoReturn

from litsim_sim.cli.arguments import Parser, number
from litsim_sim.cli.program import program
from litsim_sim.core.errors import InputError
from litsim_sim.core.stages import EGO, POLICY_STAGES
from litsim_sim.launch.executables import find_executable

STAGES = (*POLICY_STAGES, EGO)
RERUN = ("litsim_eval", "rerun")
"""Package and executable with all stages in one process; called as a program, since it depends on this package."""

KEYS = "While it plays in a terminal: space pauses, s steps, arrows seek 1 s (paused: one step), + - rate, q quits."


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_sim replay``."""
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
    kind = other.add_mutually_exclusive_group()
    kind.add_argument(
        "--repair", action="store_true", help="make a complete bag from one that was cut short; needs --out"
    )
    kind.add_argument(
        "--node", metavar="STAGE", help=f"feed a stage its recorded inputs, and compare: {', '.join(STAGES)}"
    )
    kind.add_argument("--resimulate", action="store_true", help="simulate the run again from the bag, and compare")
    other.add_argument("--out", type=Path, metavar="FOLDER", help="where --repair writes the new bag")
    other.add_argument("--json", type=Path, metavar="FILE", help="write the findings of --node or --resimulate here")
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_sim replay``."""
    words, ros = split_arguments(sys.argv[1:] if argv is None else argv)
    p = parser()
    arguments = p.parse_args(words)
    if arguments.repair != (arguments.out is not None):
        p.error("--repair and --out go together")
    if arguments.json and not (arguments.node or arguments.resimulate):
        p.error("--json goes with --node or --resimulate")
    if arguments.repair:
        _repair(arguments.bag, arguments.out)
    elif arguments.node or arguments.resimulate:
        _rerun(arguments)
    else:
        _play(arguments, ros)


def _play(arguments: argparse.Namespace, ros: list[str]) -> None:
    from litsim_sim.nodes.replay import play  # the other ways need no graph

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

    done = repair(bag, out)
    print(f"{done.path}: {done.messages.total()} messages on {len(done.messages)} topics", end="")
    print(f", attachments {', '.join(done.attachments) or 'none'}")
    for loss in done.lost or ["nothing: the bag was complete"]:
        print(f"lost: {loss}")


def _rerun(arguments: argparse.Namespace) -> NoReturn:
    """Replace this process by the program that has the stages, whose exit status is then that of this command."""
    if arguments.node and arguments.node not in STAGES:
        raise InputError(f"--node: there is no stage {arguments.node!r}, expected one of {', '.join(STAGES)}")
    path = find_executable(*RERUN)
    words = [str(path), str(arguments.bag), *(["--node", arguments.node] if arguments.node else ["--resimulate"])]
    words += ["--json", str(arguments.json)] if arguments.json else []
    sys.stdout.flush()
    os.execv(path, words)  # noqa: S606 - a list of words, never through a shell


def split_arguments(words: list[str]) -> tuple[list[str], list[str]]:
    """Split the command line into own arguments and those of ROS."""
    at = words.index("--ros-args") if "--ros-args" in words else len(words)
    return words[:at], words[at:]


if __name__ == "__main__":
    main()
