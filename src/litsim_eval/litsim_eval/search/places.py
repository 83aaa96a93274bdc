"""Where agents are, seen from egos: the places in which what an agent does concerns an ego."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

import numpy as np

from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.places import AHEAD_M, headways, places

AGENTS_MAX = 6  # most agents of a kind of act
ENTER_M = 60.0  # [m] around the ego within which agents enter
HEADWAY_STEP_S = 0.01  # to which headways are rounded
HEADWAY_ROOM_S = 0.5  # by which a cut-in leaves more headway at most than it would without other changes


@dataclass(frozen=True)
class Places:
    """Where agents are; arrays (n, k), for the agents in the n rows of a log and k moments of egos.

    Attributes:
        ahead, left: displacement from the ego, in its frame [m].
        there: whether both are on the road, and the agent is another vehicle.
        leading: whether the agent is ahead in the ego's lane.
        beside: whether it is ahead in the lane beside.
    """

    ahead: FloatArray
    left: FloatArray
    there: BoolArray
    leading: BoolArray
    beside: BoolArray

    @classmethod
    def of(cls, log: Log, egos: IntArray, steps: IntArray) -> Places:
        """Returns the places of all agents, seen from the egos in rows `egos` (k,) at `steps` (k,)."""
        there = log.valid[:, steps] & log.valid[egos, steps] & ~log.obstacle[:, None]
        there &= np.arange(len(log.ids))[:, None] != egos
        dx, dy = (values[:, steps] - values[egos, steps] for values in (log.x, log.y))
        place = places(dx, dy, log.yaw[:, steps], log.yaw[egos, steps])
        return cls(place.ahead, place.left, there, there & place.leading, there & place.beside)


def agents_by_act(scenario: Scenario, log: Log, steps: IntArray) -> dict[str, dict[int, IntArray]]:
    """Returns by kind of act the vehicles that may act so, the nearest first, each with those of `steps` at which.

    `log` holds where they and the ego drive.
    """
    place = Places.of(log, np.full(len(steps), log.row(scenario.ego_id)), steps)
    around = place.there & (np.abs(place.ahead) < AHEAD_M)
    late = (log.first_step > scenario.history_steps)[:, None]
    may = {
        "brake": place.leading,
        "cut_in": place.beside,
        "cut_out": place.leading,
        "pace": around,
        "enter": place.there & late & (np.hypot(place.ahead, place.left) < ENTER_M),
        "inattentive": around,
        "hide": around & (place.ahead > 0.0),
    }
    away = np.hypot(place.ahead, 3.0 * place.left)
    agents = {}
    for act, mask in may.items():
        least = np.where(mask, away, np.inf).min(axis=1, initial=np.inf)
        nearest = np.argsort(least, kind="stable")[: min(AGENTS_MAX, int(np.isfinite(least).sum()))]
        agents[act] = {int(log.ids[row]): steps[mask[row]] for row in nearest}
    return agents


def headway(log: Log, ego: int, agent: int, step: int) -> float:
    """Returns the headway of an ego to an agent ahead of it at a step of a log [s]; both are there."""
    own, other, steps = np.array([log.row(ego)]), np.array([log.row(agent)]), np.array([step])
    ahead = Places.of(log, own, steps).ahead[other[0]]
    return float(headways(ahead, log.length[other], log.length[own], log.speed[own, steps])[0])


def headway_bounds(act: str, headway_s: float) -> tuple[float, float]:
    """Returns the headways with which an act begins that would begin with `headway_s` without other changes.

    A cut-in leaves no less, by which it is as far from reality as that; other agents act once the ego is so near.
    """
    steps = floor(headway_s / HEADWAY_STEP_S)
    if act == "cut_in":
        return round(steps * HEADWAY_STEP_S, 2), round(steps * HEADWAY_STEP_S + HEADWAY_ROOM_S, 2)
    return 0.0, round((steps + 1) * HEADWAY_STEP_S, 2)
