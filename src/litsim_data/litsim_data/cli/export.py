"""`data export`: the trajectories of a run as CSV or Parquet."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser("export", help="trajectories of a run as CSV or Parquet")
    command.add_argument("bag", type=Path, help="folder of a run, or its MCAP file")
    command.add_argument("out", type=Path, metavar="OUT", help="OUT.csv or OUT.parquet")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Exports the run.

    Raises:
        InputError: there is no run, or OUT cannot be written.
    """
    from litsim_data.generic.trajectories import trajectories, write
    from litsim_sim.record.run import read_run

    rows = trajectories(read_run(arguments.bag))
    write(rows, arguments.out)
    counts = ", ".join(f"{count} {name}" for name, count in rows["controller"].value_counts().items())
    print(f"{arguments.out}: {len(rows)} rows of {rows['vehicle_id'].nunique()} agents ({counts})")
