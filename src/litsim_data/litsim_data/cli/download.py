"""`data download`: fetch NGSIM from the US DOT's portal."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from litsim_data.ngsim.download import DATASET, FILE, HOST


def add(subparsers: Any) -> None:
    """Add the parser of the command."""
    command = subparsers.add_parser("download", help="fetch NGSIM from the US DOT's portal; continues where it stopped")
    command.add_argument("out", type=Path, nargs="?", default=Path(FILE), metavar="OUT.csv", help="default %(default)s")
    command.add_argument("--host", default=HOST, help=f"mirror with the API of the portal, for dataset {DATASET}")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Fetch and check.

    Raises:
        InputError: as :func:`litsim_data.ngsim.download.download`.
    """
    from litsim_data.ngsim.download import download

    fetched = download(arguments.out, host=arguments.host, progress=True)
    checked = "as the portal says" if fetched.expected_rows is not None else "the portal does not say how many"
    print(f"{fetched.path}: {fetched.size} bytes, {fetched.rows} rows ({checked})")
    print(f"next: data convert {fetched.path} FOLDER")
