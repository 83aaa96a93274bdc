"""What the header of a recording says of an encounter: a vehicle that had to react to another, and what both did.

The scenario of such a recording is the world in which nothing happened: from the onset on, its log keeps both vehicles
at their pace. The ego is the opponent; what the agent truly did is kept here, apart from all that a policy sees.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.yaml_input import validate_yaml
from litsim_sim.scenario.scenario import Scenario

NOTE = "encounter"  # its name among the notes of the header
DIGITS = 4  # decimals of a track in a header: a tenth of a millimetre

EncounterKind = Literal["leader_brakes", "cut_in", "merge", "crossing", "turning", "standing"]
Split = Literal["tuning", "reported"]
KINDS: tuple[EncounterKind, ...] = get_args(EncounterKind)
SPLITS: tuple[Split, ...] = get_args(Split)
_Numbers = list[Annotated[float, Field(allow_inf_nan=False)]]


@dataclass(frozen=True)
class Track:
    """Motion of a vehicle; arrays (T,), an entry a step of 0.1 s.

    Attributes:
        x, y: box centre in frame map [m].
        yaw: heading, counter-clockwise from +x [rad].
        speed: along the heading [m/s].
    """

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray

    def __len__(self) -> int:
        return len(self.x)

    def part(self, begin: int, end: int) -> Track:
        """Returns the steps from `begin` up to `end`, exclusive."""
        return Track(*(values[begin:end] for values in (self.x, self.y, self.yaw, self.speed)))


class TrackNote(BaseModel):
    """A :class:`Track` as a header keeps it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    x: _Numbers
    y: _Numbers
    yaw: _Numbers
    speed: _Numbers

    @classmethod
    def of(cls, track: Track) -> TrackNote:
        """Returns the note of a `track`."""
        return cls(**{name: np.round(getattr(track, name), DIGITS).tolist() for name in cls.model_fields})

    @property
    def track(self) -> Track:
        """The track."""
        return Track(*(np.array(getattr(self, name), np.float64) for name in TrackNote.model_fields))


class Truth(BaseModel):
    """What both vehicles did, from step 0 of the scenario to its last step."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    agent: TrackNote
    opponent: TrackNote


class EncounterNote(BaseModel):
    """An encounter.

    Attributes:
        kind: what the opponent did.
        site: where it was recorded.
        agent: id of the vehicle that had to react.
        opponent: id of the vehicle that it had to react to, which is the ego.
        onset_step: first step at which the ego drives; the agent's record is hidden from there on.
        split: whether models may be fitted to what the agent did, or are judged by it.
        truth: what both did.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: EncounterKind
    site: str
    agent: int
    opponent: int
    onset_step: int
    split: Split
    truth: Truth

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> EncounterNote:
        """Returns the note in the header of the scenario's recording.

        Raises:
            InputError: there is none, it is malformed, or it does not fit the scenario's ego, history and end.
        """
        where, note = f"{scenario.file.recording}: header", scenario.recording.header.notes.get(NOTE)
        if not isinstance(note, dict):
            raise InputError(f"{where}: notes.{NOTE} is missing: expected a scenario by `data encounters`")
        where = f"{where}: notes.{NOTE}"
        encounter = validate_yaml(note, cls, where, "")
        encounter.check(scenario, where)
        return encounter

    def check(self, scenario: Scenario, where: str) -> None:
        """Raises an InputError if ego, history, end or agents of `scenario` differ from the note, called `where`."""
        if scenario.ego_id != self.opponent:
            raise InputError(f"{where}.opponent is {self.opponent}, expected the scenario's ego, {scenario.ego_id}")
        if scenario.history_steps != self.onset_step:
            raise InputError(f"{where}.onset_step is {self.onset_step}, expected the history, {scenario.history_steps}")
        if scenario.log.row(self.agent) < 0 or self.agent == self.opponent:
            raise InputError(f"{where}.agent is {self.agent}, expected another vehicle of the recording")
        expected = scenario.total_steps + 1
        for who in Truth.model_fields:
            for name in TrackNote.model_fields:
                if (count := len(getattr(getattr(self.truth, who), name))) != expected:
                    raise InputError(f"{where}.truth.{who}.{name} has {count} entries, expected {expected}, one a step")
