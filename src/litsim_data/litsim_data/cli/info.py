"""`data info`: describe recordings."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from litsim_data.generic.description import describe


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser("info", help="what an import of recordings would give, without writing them")
    command.add_argument("file", type=Path, help="recordings of any known format")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Describes each recording in the file, and prints the fate of its rows.

    Raises:
        InputError: it is of no known format, or one cannot be used.
    """
    from litsim_data.sources.conversion import converted
    from litsim_data.sources.importing import files_of

    for file, source in files_of(arguments.file):
        for scene in source.read(file, None):
            recording, counts = converted(scene, source)
            print(describe(recording), counts.text(), "", sep="\n")
