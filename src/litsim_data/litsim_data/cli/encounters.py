"""`data encounters`: moments of recorded traffic in which a vehicle had to react to another, as scenarios."""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tqdm import tqdm

from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.in_traffic import Traffic
from litsim_data.encounters.lack import Lack
from litsim_data.encounters.packaged import build, made_anew, rows
from litsim_data.encounters.table import TABLE, EncounterRow, table_text
from litsim_data.mining.suite_file import write_scenario
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import require_new_folder, write_text
from litsim_sim.scenario.encounter_note import KINDS, SPLITS
from litsim_sim.scenario.scenario import DATA_VARIABLE

PACKAGED = "packaged"  # in place of a recording: those of the packaged table


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser(
        "encounters",
        help="moments in which a vehicle had to react to another, as scenarios with what it truly did",
        description="Search a recording for moments in which one vehicle had to react to another, and write each as a "
        "scenario: its log is the world in which nothing happened, its ego is the other vehicle, to be driven by "
        "`--ego track`, and the header of its recording tells what both truly did. docs/credibility.md has more.",
    )
    recordings = f"recording of any known format, scenario, or `{PACKAGED}`: those of the published data"
    command.add_argument("recording", nargs="?", metavar="RECORDING", help=recordings)
    command.add_argument("out", nargs="?", type=Path, metavar="OUT", help="new folder for scenarios and encounters.csv")
    command.add_argument("--net", help="packaged net or file; default: the net that the recording names")
    kinds = f"what the other vehicle did, of {', '.join(KINDS)}; default: any"
    command.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, metavar="KIND", help=kinds)
    command.add_argument("--split", choices=SPLITS, help="only encounters of vehicles to fit to, or to report on")
    command.add_argument("--table", type=Path, metavar="FILE", help="instead: make the table of the packaged ones anew")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Searches and writes, and prints the result.

    Raises:
        InputError: the recording cannot be used, has no encounter, or OUT cannot be written.
    """
    left_out = Counter[Lack]()
    if arguments.table is not None:
        table = list(tqdm(made_anew(_data(), left_out), unit=" encounters", leave=False, disable=None))
        write_text(arguments.table, table_text(table))
    elif arguments.out is None:
        raise InputError("data encounters: name a RECORDING and the folder OUT to write, or --table FILE")
    else:
        require_new_folder(arguments.out)
        table = _write_all(arguments, left_out)
    for lack, count in sorted(left_out.items()):
        print(f"{count} left out: {lack}")
    kinds = Counter(row.kind for row in table)
    print(f"{len(table)} encounters: {', '.join(f'{count} {kind}' for kind, count in kinds.most_common())}")


def _write_all(arguments: argparse.Namespace, left_out: Counter[Lack]) -> list[EncounterRow]:
    """Writes the encounters and their table, also if interrupted, and returns the rows."""
    table = list[EncounterRow]()
    try:
        for row, encounter in _packaged(arguments) if arguments.recording == PACKAGED else _found(arguments, left_out):
            write_scenario(encounter.scenario, arguments.out / f"{encounter.name}.yaml")
            table.append(row)
    finally:
        if table:
            write_text(arguments.out / TABLE, table_text(table))
    if not table:
        reasons = "; ".join(f"{count} left out: {lack}" for lack, count in sorted(left_out.items()))
        raise InputError(
            f"{arguments.recording}: no encounter of the kinds asked for" + (f"; {reasons}" if reasons else "")
        )
    return table


def _found(arguments: argparse.Namespace, left_out: Counter[Lack]) -> Iterator[tuple[EncounterRow, Encounter]]:
    """Yields the encounters in a recording, and their rows."""
    traffic = Traffic.of(arguments.recording, arguments.net, left_out)
    for block in tqdm(traffic.blocks, unit=" min", leave=False, disable=None):
        for encounter in traffic.encounters(block, arguments.kinds):
            if arguments.split in (None, encounter.note.split):
                yield EncounterRow.of(encounter, arguments.recording, traffic.period), encounter


def _packaged(arguments: argparse.Namespace) -> Iterator[tuple[EncounterRow, Encounter]]:
    """Yields the packaged encounters, and their rows."""
    wanted = [row for row in rows(arguments.split) if row.kind in arguments.kinds]
    by_name = {row.name: row for row in wanted}
    for encounter in tqdm(build(wanted, _data()), total=len(wanted), unit=" encounters", leave=False, disable=None):
        yield by_name[encounter.name], encounter


def _data() -> Path:
    """Returns the folder of the published data; raises an InputError if it is not known."""
    data = os.environ.get(DATA_VARIABLE)
    if not data:
        raise InputError(f"{DATA_VARIABLE} is not set, expected the folder of the published data (docs/data.md)")
    return Path(data)
