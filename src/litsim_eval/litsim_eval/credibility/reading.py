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
from litsim_data.encounters.packaged import build, rows
from litsim_eval.campaign.case import file_digest
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.encounter_note import Split
from litsim_sim.scenario.scenario import DATA_VARIABLE, Scenario

T = TypeVar("T")
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


def packaged_ones(split: Split | None, limit: int | None) -> Selection:
    """Returns encounters of the packaged table, reported ones unless `split` says otherwise, built from the data.

    Raises:
        InputError: LITSIM_DATA is not set, or a file is missing there.
    """
    if not (folder := os.environ.get(DATA_VARIABLE)):
        raise InputError(
            f"{DATA_VARIABLE} is not set, expected the folder with NGSIM's files from which the packaged encounters "
            "are built (docs/data.md); --recording takes encounters of your own"
        )
    chosen = spread([row for row in rows() if row.split == (split or REPORTED)], limit)
    encounters = tuple(build(chosen, Path(folder)))
    count = Counter((row.source, row.licence) for row in chosen)
    files = [
        DataFile(name, licence, n, file_digest(Path(folder, name))) for (name, licence), n in sorted(count.items())
    ]
    return Selection(encounters, tuple(files))


def those_at(path: Path, split: Split | None, limit: int | None) -> Selection:
    """Returns encounters in the scenario files of a folder, sorted by name, or in one scenario file.

    Raises:
        InputError: there is none, or none of this `split`, or a file cannot be used.
    """
    paths = sorted(path.glob("*.yaml")) if path.is_dir() else [path]
    if not paths:
        raise InputError(f"{path}: no scenario in this folder, expected encounters by `data encounters`")
    encounters = [Encounter.of_scenario(Scenario.load(each)) for each in paths]
    of_split = [each for each in encounters if split in (None, each.split)]
    if not of_split:
        raise InputError(f"{path}: no encounter of part {split}, expected at least one")
    chosen = spread(of_split, limit)
    count = Counter((Path(each.scenario.file.recording), each.licence) for each in chosen)
    count += Counter((each.scenario.net_path, "") for each in chosen)
    files = [DataFile(each.name, licence, n, file_digest(each)) for (each, licence), n in sorted(count.items())]
    return Selection(tuple(chosen), tuple(files))


def spread(sequence: Sequence[T], limit: int | None) -> list[T]:
    """Returns at most `limit` of a sequence, all for None, spread evenly over it."""
    count = min(len(sequence), limit or len(sequence))
    return [sequence[at] for at in np.linspace(0, len(sequence) - 1, count).round().astype(int).tolist()]
