"""Predicted motions: boxes of agents at the next steps, with their uncertainty and alternatives."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cache, cached_property

import numpy as np

from litsim_predictor.forecast import Float32Array
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray

X, Y, YAW, XX, YY, XY = range(6)  # columns of `PredictedMotion.states`


@dataclass
class AlternativeMotions:
    """q alternative motions of some of n agents.

    Attributes:
        row: (q,) of the agent.
        weight: (q,) probability of the motion; the first motion of an agent has the remainder to 1.
        states, valid: (q, T, 6), (q, T), as in :class:`PredictedMotion`.
    """

    row: IntArray
    weight: FloatArray
    states: FloatArray
    valid: BoolArray

    @classmethod
    @cache
    def none(cls, steps: int = 0) -> AlternativeMotions:
        """Return no alternative motions, for futures of T = `steps`."""
        return cls(np.empty(0, np.int64), np.empty(0), np.empty((0, steps, 6)), np.empty((0, steps), np.bool_))

    def __len__(self) -> int:
        return len(self.row)

    def joined(self, other: AlternativeMotions) -> AlternativeMotions:
        """Returns these motions and those of `other`, which are of other agents."""
        if not len(other):
            return self
        columns = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return AlternativeMotions(*map(np.concatenate, columns))

    @cached_property
    def directions(self) -> tuple[Float32Array, Float32Array]:
        """Cosines and sines (q, T) of the headings, as in :class:`PredictedMotion`."""
        return _directions(self.states)


@dataclass
class PredictedMotion:
    """Boxes of n agents at T future steps of 0.1 s, the first of them 0.1 s ahead.

    Attributes:
        states: (n, T, 6) x, y [m], yaw [rad] and covariance xx, yy, xy [m2] of the centre, frame map.
        valid: (n, T) whether the agent is known to be on the road then.
        alternatives: other motions that are possible.
    """

    states: FloatArray
    valid: BoolArray
    alternatives: AlternativeMotions = field(default_factory=AlternativeMotions.none)

    @property
    def x(self) -> FloatArray:
        """Coordinate x (n, T) of the centre [m]."""
        return self.states[..., X]

    @property
    def y(self) -> FloatArray:
        """Coordinate y (n, T) of the centre [m]."""
        return self.states[..., Y]

    @property
    def yaw(self) -> FloatArray:
        """Heading (n, T) [rad]."""
        return self.states[..., YAW]

    @cached_property
    def directions(self) -> tuple[Float32Array, Float32Array]:
        """Cosines and sines (n, T) of the headings, in single precision: numpy computes these twenty times as fast."""
        return _directions(self.states)

    def replaced(self, rows: BoolArray, other: PredictedMotion) -> PredictedMotion:
        """Returns these motions, with those of `other` for agents in the mask `rows` (n,), which have none yet."""
        motions = PredictedMotion(self.states.copy(), self.valid.copy(), self.alternatives.joined(other.alternatives))
        motions.put(rows, other)
        return motions

    def put(self, rows: BoolArray, other: PredictedMotion) -> None:
        """Copy the motions of agents in the mask `rows` (n,), which have none yet, from `other`, in place.

        Call it before directions are read.
        """
        index = rows.nonzero()[0]
        self.states[index], self.valid[index] = other.states[index], other.valid[index]


def _directions(states: FloatArray) -> tuple[Float32Array, Float32Array]:
    """Returns cosines and sines (n, T) of the headings in `states` (n, T, 6)."""
    yaw = states[..., YAW].astype(np.float32)
    return np.cos(yaw), np.sin(yaw)
