"""`data clean`: smooth the motion of a recording consistently, and report the changes."""

from __future__ import annotations

import argparse
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from litsim_data.cleaning.cleaning import CleaningConfig, CleaningReport, clean, front_centres
from litsim_data.description import describe
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import refuse_input_as_output
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording

OPTIONS = {
    "longitudinal_period_s": "oscillations along the road of this period are halved, shorter ones vanish [s]",
    "lateral_period_s": "the same across the road [s]",
    "path_speed": "speed below which paths are smoothed over length instead of time [m/s]",
    "huber": "residuals beyond this are outliers [m]",
}
"""Fields of the configuration that can be set, and their help."""


def add(subparsers: Any) -> None:
    """Add the parser of the command."""
    command = subparsers.add_parser("clean", help="smooth the motion of a recording, and report the changes")
    command.add_argument("source", type=Path, metavar="IN", help="recording of any known format (crop it with convert)")
    command.add_argument("out", type=Path, metavar="OUT.parquet")
    defaults = asdict(CleaningConfig())
    for name, text in OPTIONS.items():
        option = f"--{name.removesuffix('_s').replace('_', '-')}"
        command.add_argument(
            option, dest=name, type=float, metavar="NUMBER", help=f"{text}; default {defaults[name]:g}"
        )
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Clean, and print the figures before and after.

    Raises:
        InputError: as :func:`clean_recording`, or an option is out of range.
    """
    refuse_input_as_output(arguments.out, arguments.source)
    given = {name: getattr(arguments, name) for name in OPTIONS if getattr(arguments, name) is not None}
    config = CleaningConfig(**given)
    recording = load_recording(arguments.source)
    cleaned, report = clean_recording(recording, config, str(arguments.source), progress=True)
    cleaned.write(arguments.out)
    print(describe(cleaned))
    print()
    print(report.table())


def clean_recording(
    recording: Recording, config: CleaningConfig, where: str, *, progress: bool = False
) -> tuple[Recording, CleaningReport]:
    """A cleaned recording, whose header says how, and the figures; `where` names it in errors.

    Raises:
        InputError: the recording was cleaned before, or vehicles jump.
    """
    if "cleaned" in recording.header.notes:
        raise InputError(f"{where}: was cleaned before, as its header says; clean the original")
    table, report = clean(front_centres(recording.table), config, progress=progress)
    notes = {**recording.header.notes, "cleaned": {field.name: getattr(config, field.name) for field in fields(config)}}
    return Recording.from_table(replace(recording.header, notes=notes), table, where), report
