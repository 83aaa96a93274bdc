"""Which encounters are driven: those in files of the user's, or the packaged ones."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.in_traffic import Traffic
from litsim_data.encounters.lack import Lack
from litsim_data.encounters.packaged import build, rows
from litsim_eval.campaign.case import file_digest
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.encounter_note import NOTE, Split
from litsim_sim.scenario.scenario import DATA_VARIABLE, Scenario, packaged_scenarios

T = TypeVar("T")
Source = tuple[Encounter, Path]
"""An encounter, and the recording that it is from."""
REPORTED: Split = "reported"


@dataclass(frozen=True)
class DataFile:
    """A file that encounters were read from.

    Attributes:
        file: its name.
        licence: of its content; empty if the file does not tell it.
        encounters: number of encounters from it.
        sha256: digest, in hexadecimal digits.
    """

    file: str
    licence: str
    encounters: int
    sha256: str


@dataclass(frozen=True)
class Selection:
    """Encounters, and the files that they were read from."""

    encounters: tuple[Encounter, ...]
    files: tuple[DataFile, ...]


def packaged_encounters(split: Split | None, limit: int | None) -> Selection:
    """Returns encounters of the packaged table, reported ones unless `split` says otherwise, built from the data.

    Raises:
        InputError: LITSIM_DATA is not set, or a file is missing there.
    """
    if not (folder := os.environ.get(DATA_VARIABLE)):
        raise InputError(
            f"{DATA_VARIABLE} is not set, expected the folder with NGSIM's files from which the packaged encounters "
            "are built (docs/data.md); --recording takes encounters of your own"
        )
    chosen = spread(rows(split or REPORTED), limit)
    encounters = tuple(build(chosen, Path(folder)))
    count = Counter((row.source, row.licence) for row in chosen)
    files = [
        DataFile(name, licence, n, file_digest(Path(folder, name))) for (name, licence), n in sorted(count.items())
    ]
    return Selection(encounters, tuple(files))


def encounters_in(name: str, split: Split | None, limit: int | None) -> Selection:
    """Returns encounters in a folder, sorted by file, or in a scenario or a recording, of one `split` or of both.

    A scenario that is none, and a recording, are searched for encounters, as by `data encounters`.

    Raises:
        InputError: there is none, or none of this `split`, or a file cannot be used.
    """
    path = Path(name)
    sources = _in_folder(path) if path.is_dir() else _in_file(name)
    of_split = [(encounter, recording) for encounter, recording in sources if split in (None, encounter.note.split)]
    if not of_split:
        raise InputError(f"{name}: no encounter of part {split}, expected at least one")
    return _selection(spread(of_split, limit))


def _in_folder(folder: Path) -> list[Source]:
    """Returns the encounters in a folder of scenarios; raises an InputError without any, or if a scenario is none."""
    scenarios = [Scenario.load(path) for path in sorted(folder.glob("*.yaml"))]
    if not scenarios:
        raise InputError(f"{folder}: no scenario in this folder, expected encounters by `data encounters`")
    return [_of_scenario(scenario) for scenario in scenarios]


def _of_scenario(scenario: Scenario) -> Source:
    """Returns the encounter that a scenario is; raises an InputError if it is none."""
    return Encounter.of_scenario(scenario), Path(scenario.file.recording)


def _in_file(name: str) -> list[Source]:
    """Returns the encounter that a scenario is, or those that are found in it or in a recording.

    Raises:
        InputError: there is none, or the file cannot be used.
    """
    recording = Path(name)
    if name in packaged_scenarios() or recording.suffix in (".yaml", ".yml"):
        scenario = Scenario.load(name)
        if NOTE in scenario.recording.header.notes:
            return [_of_scenario(scenario)]
        recording = Path(scenario.file.recording)
    left_out = Counter[Lack]()
    traffic = Traffic.of(name, None, left_out)
    sources = [(own, recording) for block in traffic.blocks for own in traffic.encounters(block)]
    if not sources:
        reasons = "".join(f"; {count} left out: {lack}" for lack, count in sorted(left_out.items()))
        raise InputError(f"{name}: no moment in which a vehicle had to react to another{reasons}")
    return sources


def _selection(sources: Sequence[Source]) -> Selection:
    """Returns the encounters of `sources`, with digests of recordings and nets."""
    count = Counter((recording, encounter.licence) for encounter, recording in sources)
    count += Counter((encounter.scenario.net_path, "") for encounter, _ in sources)
    files = [DataFile(path.name, licence, n, file_digest(path)) for (path, licence), n in sorted(count.items())]
    return Selection(tuple(encounter for encounter, _ in sources), tuple(files))


def spread(sequence: Sequence[T], limit: int | None) -> list[T]:
    """Returns at most `limit` of a sequence, all for None, spread evenly over it."""
    count = min(len(sequence), limit or len(sequence))
    return [sequence[k] for k in np.linspace(0, len(sequence) - 1, count).round().astype(int).tolist()]
