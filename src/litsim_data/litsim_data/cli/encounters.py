"""`data encounters`: moments of recorded traffic in which a vehicle had to react to another, as scenarios."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from litsim_data.encounters.packaged import table, table_text
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing
from litsim_sim.scenario.scenario import DATA_VARIABLE


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser(
        "encounters", help="moments in which a vehicle had to react to another, as scenarios"
    )
    command.add_argument("--table", type=Path, metavar="FILE", help="make the table of the packaged encounters anew")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Makes the table, and prints the result."""
    data = os.environ.get(DATA_VARIABLE)
    if not data:
        raise InputError(f"{DATA_VARIABLE} is not set, expected the folder of the published data (docs/data.md)")
    made, lacks = table(Path(data))
    with replacing(arguments.table) as new:
        new.write_text(table_text(made), encoding="utf-8")
    print(f"{arguments.table}: {len(made)} encounters")
    for lack, count in sorted(lacks.items()):
        print(f"{count} left out: {lack}")
