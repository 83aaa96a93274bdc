"""What agents did in simulated encounters beside what people did there, as arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self

import numpy as np

from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.reaction import Reaction
from litsim_eval.credibility.running import Drive
from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.scenario.encounter_note import Track

LOOK_STEPS = 60
"""Steps after the onset whose positions are compared: 6 s."""
NEAR_GAP, NEAR_TTC = 1.0, 1.5
"""A near miss has a least gap [m] or a least time to collision [s] below these."""
WIDE_GAP, WIDE_TTC, WIDE_BRAKING = 2.0, 2.5, -2.5
"""The wide verdict also takes in what is no near miss yet: gap [m], time to collision [s], acceleration [m/s2]."""


@dataclass(frozen=True)
class Reactions:
    """The fields of :class:`Reaction` as arrays of one shape, (n,) of people or (n, k) of k drivers; NaN if unknown."""

    onset: FloatArray
    strongest_braking: FloatArray
    speed_lost: FloatArray
    least_gap: FloatArray
    least_ttc: FloatArray
    contact: BoolArray

    @classmethod
    def of(cls, reactions: Sequence[Reaction]) -> Self:
        """Returns arrays (n,) of `reactions`."""
        return cls(*(np.array([getattr(own, name) for own in reactions]) for name in _names(cls)))

    def reshaped(self, *shape: int) -> Self:
        """Returns the same in another shape."""
        return self._each(lambda values: values.reshape(shape))

    def take(self, rows: IntArray) -> Self:
        """Returns the reactions in the encounters `rows`."""
        return self._each(lambda values: values[rows])

    @property
    def margin(self) -> FloatArray:
        """Least gap and least time to collision, the smaller one, in units of the bounds of a near miss."""
        return np.minimum(self.least_gap / NEAR_GAP, self.least_ttc / NEAR_TTC)

    @property
    def near_miss(self) -> BoolArray:
        """Whether it was a near miss."""
        return np.asarray(self.margin < 1.0)

    @property
    def wide(self) -> BoolArray:
        """The wide verdict: whether it was close or the agent braked hard."""
        close = (self.least_gap < WIDE_GAP) | (self.least_ttc < WIDE_TTC)
        return np.asarray(close | (self.strongest_braking < WIDE_BRAKING))

    def _each(self, change: Callable[[Any], Any]) -> Self:
        return type(self)(*(change(getattr(self, name)) for name in _names(type(self))))


@dataclass(frozen=True)
class Responses:
    """All encounters driven by one setup: n encounters, k drivers each.

    Attributes:
        encounters: the encounters.
        drives: what was driven in each, by each driver.
        people: what people did (n,).
        simulated: what simulated drivers did (n, k).
        taken_over_s: time from the onset until the agent left its log (n, k) [s]; NaN if it never did.
        touched: whether the agent touched anyone (n, k).
        along, across: position relative to the record, ahead and to the left of it, at each step from the onset on
            (n, k, :data:`LOOK_STEPS` + 1) [m]; NaN once one of the tracks has ended.
    """

    encounters: tuple[Encounter, ...]
    drives: tuple[tuple[Drive, ...], ...]
    people: Reactions
    simulated: Reactions
    taken_over_s: FloatArray
    touched: BoolArray
    along: FloatArray
    across: FloatArray

    @classmethod
    def of(cls, encounters: Sequence[Encounter], drives: Sequence[Sequence[Drive]]) -> Self:
        """Returns the responses of `drives`, as many for each of `encounters`, one at least."""
        shape = len(encounters), len(drives[0])
        pairs = [(encounter, own) for encounter, driven in zip(encounters, drives, strict=True) for own in driven]
        offsets = np.array([_offsets(encounter, own.track) for encounter, own in pairs])
        late = [np.nan if own.taken_over_s is None else own.taken_over_s for _, own in pairs]
        simulated = Reactions.of([encounter.reaction(own.track) for encounter, own in pairs]).reshaped(*shape)
        return cls(
            encounters=tuple(encounters),
            drives=tuple(map(tuple, drives)),
            people=Reactions.of([encounter.people for encounter in encounters]),
            simulated=simulated,
            taken_over_s=np.array(late, np.float64).reshape(shape),
            touched=simulated.contact | np.array([own.contact for _, own in pairs]).reshape(shape),
            along=offsets[:, 0].reshape(*shape, -1),
            across=offsets[:, 1].reshape(*shape, -1),
        )

    def take(self, rows: IntArray) -> Self:
        """Returns the responses in the encounters `rows`."""
        arrays = (getattr(self, name)[rows] for name in ("taken_over_s", "touched", "along", "across"))
        order = rows.tolist()
        encounters, drives = tuple(self.encounters[row] for row in order), tuple(self.drives[row] for row in order)
        return type(self)(encounters, drives, self.people.take(rows), self.simulated.take(rows), *arrays)

    @property
    def kinds(self) -> dict[str, IntArray]:
        """Rows of the encounters of each kind, by name."""
        kind = np.array([encounter.note.kind for encounter in self.encounters])
        return {name: np.flatnonzero(kind == name) for name in dict.fromkeys(kind.tolist())}

    @cached_property
    def vehicles(self) -> IntArray:
        """(n,) number of the vehicle that reacts, from 0 on: encounters of one vehicle resemble each other."""
        return numbered((encounter.note.site, encounter.note.agent) for encounter in self.encounters)

    def row(self, encounter: Encounter) -> int | None:
        """Returns the row of an encounter; None if it is not among these."""
        return next((row for row, own in enumerate(self.encounters) if own is encounter), None)

    @property
    def drivers(self) -> int:
        """Number of drivers in each encounter."""
        return self.along.shape[1]


def numbered(keys: Iterable[Any]) -> IntArray:
    """Returns the number of each key, equal for equal ones, from 0 on in the order of their first appearance."""
    number: dict[Any, int] = {}
    return np.array([number.setdefault(key, len(number)) for key in keys], np.int64)


def _offsets(encounter: Encounter, track: Track) -> FloatArray:
    """Returns how far ahead and to the left of the record `track` is (2, steps) [m]; see :class:`Responses`."""
    truth, begin = encounter.truth, encounter.note.onset_step
    steps = slice(begin, min(len(truth), len(track), begin + LOOK_STEPS + 1))
    offsets = np.full((2, LOOK_STEPS + 1), np.nan)
    away = track.x[steps] - truth.x[steps], track.y[steps] - truth.y[steps]
    offsets[:, : steps.stop - steps.start] = to_body(*away, truth.yaw[steps])
    return offsets


def _names(cls: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(cls))
