"""The encounters of the published data: a table that is part of this package, and scenarios built from the data."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any

from litsim_data.encounters import straight_road
from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.following import LANES, PAIRS, VEHICLES, FollowingTrack, lanes, pairs, vehicles
from litsim_data.encounters.leader_brakes import Braking, Lack, brakings
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.encounter_note import EncounterKind, Split

TABLE = "encounters.csv"
DECIMALS = 3  # of figures in the table
READERS = {PAIRS: pairs, LANES: lanes, VEHICLES: vehicles}
"""Functions that read the recorded car following in each source."""


@dataclass(frozen=True)
class EncounterRow:
    """A row of the table.

    Attributes:
        name: of the scenario.
        site: where it was recorded.
        kind: what the opponent did.
        source: file, relative to LITSIM_DATA.
        period: of the recording.
        agent, opponent: ids of the vehicle that had to react, and of the one that it had to react to.
        onset_frame: frame of the onset.
        split: part of the agent.
        licence: of the source.
        onset_s, strongest_braking_mps2, speed_lost_mps, least_gap_m, least_ttc_s: what the agent did, see
            :class:`.reaction.Reaction`.
    """

    name: str
    site: str
    kind: EncounterKind
    source: str
    period: int
    agent: int
    opponent: int
    onset_frame: int
    split: Split
    licence: str
    onset_s: float
    strongest_braking_mps2: float
    speed_lost_mps: float
    least_gap_m: float
    least_ttc_s: float

    @classmethod
    def of(cls, encounter: Encounter, source: str, period: int) -> EncounterRow:
        """Returns the row of an encounter in `source`."""
        people = encounter.people
        return cls(
            name=encounter.name,
            site=encounter.site,
            kind=encounter.kind,
            source=source,
            period=period,
            agent=encounter.agent,
            opponent=encounter.opponent,
            onset_frame=encounter.scenario.start_frame + encounter.onset_step,
            split=encounter.split,
            licence=encounter.licence,
            onset_s=round(people.onset, DECIMALS),
            strongest_braking_mps2=round(people.strongest_braking, DECIMALS),
            speed_lost_mps=round(people.speed_lost, DECIMALS),
            least_gap_m=round(people.least_gap, DECIMALS),
            least_ttc_s=round(people.least_ttc, DECIMALS),
        )


def rows(split: Split | None = None) -> tuple[EncounterRow, ...]:
    """Returns the rows of the packaged table, of one `split` or of both."""
    text = resources.files("litsim_data.encounters").joinpath(TABLE).read_text(encoding="utf-8")
    table = (_row(values) for values in csv.DictReader(text.splitlines()))
    return tuple(row for row in table if split is None or row.split == split)


def build(wanted: Iterable[EncounterRow], data: Path) -> Iterator[Encounter]:
    """Yields the encounters of the rows `wanted` from the files below `data`, in the order of the table.

    Raises:
        InputError: a file is missing, or does not have an encounter.
    """
    left = {row.name: row for row in wanted}
    for source, reader in READERS.items():
        agents = {(row.period, row.agent) for row in left.values() if row.source == source}
        tracks = reader(data) if agents else ()
        for braking in _brakings(track for track in tracks if (track.period, track.follower) in agents):
            if left.pop(braking.name, None) is not None:
                yield straight_road.encounter(braking)
    if left:
        name, row = next(iter(left.items()))
        raise InputError(f"{data / row.source}: has no encounter {name}: is it the file that the table was made from?")


def table(data: Path) -> tuple[list[EncounterRow], Counter[Lack]]:
    """Returns the rows of all encounters in the files below `data`, and how many others were left out, and why.

    Raises:
        InputError: a file is missing, or lacks a column.
    """
    made, lacks = list[EncounterRow](), Counter[Lack]()
    for source, reader in READERS.items():
        for braking in _brakings(reader(data)):
            if braking.lack:
                lacks[braking.lack] += 1
            else:
                made.append(EncounterRow.of(straight_road.encounter(braking), source, braking.track.period))
    return made, lacks


def table_text(made: Iterable[EncounterRow]) -> str:
    """Returns rows as the text of a CSV file."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, [field.name for field in fields(EncounterRow)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in made)
    return stream.getvalue()


def _brakings(tracks: Iterable[FollowingTrack]) -> Iterator[Braking]:
    return (braking for track in tracks for braking in brakings(track))


def _row(values: dict[str, str]) -> EncounterRow:
    """Returns the row with `values` by column."""
    types: dict[Any, type] = {"int": int, "float": float}
    return EncounterRow(**{each.name: types.get(each.type, str)(values[each.name]) for each in fields(EncounterRow)})
