"""`data clean`: smooth the motion of a recording consistently, and report the changes."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from litsim_data.cleaning.cleaning import clean, front_centres
from litsim_data.cleaning.track_fit import CleaningConfig
from litsim_data.generic.description import describe
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import refuse_input_as_output
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser("clean", help="smooth the motion of a recording, and report the changes")
    command.add_argument("source", type=Path, metavar="IN", help="recording of any known format (crop it with convert)")
    command.add_argument("out", type=Path, metavar="OUT.parquet")
    for direction, default in (
        ("longitudinal", CleaningConfig.longitudinal_period_s),
        ("lateral", CleaningConfig.lateral_period_s),
    ):
        text = f"{direction} oscillations of this period are halved, shorter ones vanish [s]; default %(default)s"
        command.add_argument(f"--{direction}-period", type=float, default=default, metavar="NUMBER", help=text)
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Cleans, and prints the figures before and after.

    Raises:
        InputError: the recording was cleaned before, vehicles in it jump, or an option is out of range.
    """
    refuse_input_as_output(arguments.out, arguments.source)
    config = CleaningConfig(arguments.longitudinal_period, arguments.lateral_period)
    recording = load_recording(arguments.source)
    if "cleaned" in recording.header.notes:
        raise InputError(f"{arguments.source}: was cleaned before, as its header says; clean the original")
    table, report = clean(front_centres(recording.table), config)
    header = replace(recording.header, notes={**recording.header.notes, "cleaned": asdict(config)})
    cleaned = Recording.from_table(header, table, str(arguments.source))
    cleaned.write(arguments.out)
    print(describe(cleaned))
    print()
    print(report.table())
