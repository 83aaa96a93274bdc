"""Tables of encounters: one row each, with what people did in figures."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import Any

from litsim_data.encounters.encounter import Encounter
from litsim_sim.scenario.encounter_note import EncounterKind, Split

TABLE = "encounters.csv"
DECIMALS = 3


@dataclass(frozen=True)
class EncounterRow:
    """A row of the table.

    Attributes:
        name: of the scenario.
        site: where it was recorded.
        kind: what the opponent did.
        source: file of the record; of packaged encounters relative to LITSIM_DATA.
        period: which of the recordings of the site it is.
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
            site=encounter.note.site,
            kind=encounter.note.kind,
            source=source,
            period=period,
            agent=encounter.note.agent,
            opponent=encounter.note.opponent,
            onset_frame=encounter.scenario.start_frame + encounter.note.onset_step,
            split=encounter.note.split,
            licence=encounter.licence,
            onset_s=round(people.onset, DECIMALS),
            strongest_braking_mps2=round(people.strongest_braking, DECIMALS),
            speed_lost_mps=round(people.speed_lost, DECIMALS),
            least_gap_m=round(people.least_gap, DECIMALS),
            least_ttc_s=round(people.least_ttc, DECIMALS),
        )


def table_text(rows: Iterable[EncounterRow]) -> str:
    """Returns `rows` as the text of a CSV file."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, [field.name for field in fields(EncounterRow)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    return stream.getvalue()


def table_rows(text: str) -> tuple[EncounterRow, ...]:
    """Returns the rows of a table that :func:`table_text` wrote."""
    types: dict[Any, type] = {"int": int, "float": float}  # the fields' types are text here
    columns = {field.name: types.get(field.type, str) for field in fields(EncounterRow)}
    table = csv.DictReader(text.splitlines())
    return tuple(EncounterRow(**{name: kind(values[name]) for name, kind in columns.items()}) for values in table)
