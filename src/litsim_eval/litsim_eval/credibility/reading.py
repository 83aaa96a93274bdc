"""Which encounters are driven: those in files of the user's, or the packaged ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from litsim_data.encounters.encounter import Encounter
from litsim_eval.campaign.case import file_digest
from litsim_eval.credibility.evidence import DataFile
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.encounter_note import Split
from litsim_sim.scenario.scenario import Scenario


def encounters_at(path: Path) -> list[Encounter]:
    """Returns the encounters in the scenario files of a folder, sorted by name, or in one scenario file.

    Raises:
        InputError: there is none, or a file cannot be used.
    """
    files = sorted(path.glob("*.yaml")) if path.is_dir() else [path]
    if not files:
        raise InputError(f"{path}: no scenario in this folder, expected encounters by `data encounters`")
    return [Encounter.of_scenario(Scenario.load(file)) for file in files]


def data_files(encounters: Sequence[Encounter]) -> list[DataFile]:
    """Returns the recordings and nets of `encounters`, sorted by path."""
    count = Counter((Path(each.scenario.file.recording), each.licence) for each in encounters)
    count += Counter((each.scenario.net_path, "") for each in encounters)
    return [DataFile(path.name, licence, count[path, licence], file_digest(path)) for path, licence in sorted(count)]


def chosen(encounters: Sequence[Encounter], split: Split | None, limit: int | None, where: str) -> list[Encounter]:
    """Returns the encounters of a part, all for None, and at most `limit` of them, spread evenly over the sequence.

    Raises:
        InputError: there is none; `where` names what they are from.
    """
    of_part = [each for each in encounters if split in (None, each.split)]
    if not of_part:
        raise InputError(f"{where}: no encounter of part {split}, expected at least one")
    count = min(len(of_part), limit or len(of_part))
    return [of_part[at] for at in np.linspace(0, len(of_part) - 1, count).round().astype(int).tolist()]
