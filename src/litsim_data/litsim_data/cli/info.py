"""`data info`: describe a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from litsim_data.description import describe
from litsim_data.ngsim import formats as ngsim_format
from litsim_sim.scenario.load import load_recording


def add(subparsers: Any) -> None:
    """Add the parser of the command."""
    command = subparsers.add_parser("info", help="describe a recording; official NGSIM files are read, not converted")
    command.add_argument("file", type=Path, help="recording of any known format")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Describe the file.

    Raises:
        InputError: it is no recording, or a line of an official file cannot be used.
    """
    path: Path = arguments.file
    if path.is_file() and ngsim_format.detect(path) is not None:
        from litsim_data.ngsim.summary import summary

        print(summary(path, progress=True))
    else:
        print(describe(load_recording(path)))
