"""`data info`: describe a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from litsim_data.generic.description import describe
from litsim_data.ngsim.formats import is_official
from litsim_sim.scenario.load import load_recording


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser("info", help="describe a recording; official NGSIM files are read, not converted")
    command.add_argument("file", type=Path, help="recording of any known format")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Describes the file.

    Raises:
        InputError: it is no recording, or a line of an official file cannot be used.
    """
    if is_official(arguments.file):
        from litsim_data.ngsim.summary import summary

        print(summary(arguments.file))
    else:
        print(describe(load_recording(arguments.file)))
