"""`live`: show a run, or its replay, in RViz and Foxglove, by markers and by a WebSocket server for Foxglove."""

from __future__ import annotations

import argparse
import sys

from litsim_sim.cli.arguments import Parser, number
from litsim_sim.cli.program import program
from litsim_sim.cli.replay import split_arguments
from litsim_sim.nodes.live_server import HOST, PORT

RATE_MAX = 100.0  # [Hz]
PORTS = range(2**16)


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_sim live``."""
    p = Parser(prog="live", description=__doc__)
    p.add_argument(
        "--rate",
        type=number(0.0, RATE_MAX, above=True),
        default=20.0,
        metavar="HZ",
        help="largest number of frames per second (default: 20)",
    )
    serving = p.add_argument_group("Foxglove over a WebSocket (needs foxglove-sdk)")
    serving.add_argument("--foxglove", action="store_true", help="serve all topics and the markers")
    serving.add_argument("--port", type=_port, help=f"default: {PORT}; 0 takes a free one")
    serving.add_argument("--host", help=f"address to listen on (default: {HOST}, this machine only)")
    serving.add_argument(
        "--allow-origin",
        nargs="+",
        metavar="URL",
        help="pages that may connect, beside Foxglove's and those of this machine, such as https://viewer.example.org",
    )
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_sim live``."""
    own, ros = split_arguments(sys.argv[1:] if argv is None else argv)
    p = parser()
    arguments = p.parse_args(own)
    serving = arguments.port, arguments.host, arguments.allow_origin
    if not arguments.foxglove and serving != (None, None, None):
        p.error("--port, --host and --allow-origin go with --foxglove")
    from litsim_sim.nodes.live import live  # ROS takes a moment to load

    host, port = arguments.host or HOST, PORT if arguments.port is None else arguments.port
    live(ros, arguments.rate, (host, port, arguments.allow_origin or ()) if arguments.foxglove else None)


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) not in PORTS:
        raise argparse.ArgumentTypeError(f"{text!r}, expected 0 to {PORTS[-1]}")
    return int(text)
