"""Where agents are, seen from egos: the places in which what an agent does concerns an ego."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

AGENTS_MAX = 6  # most agents of a kind of act
ENTER_M = 60.0  # [m] around the ego within which agents enter
AHEAD_M = 80.0  # [m] ahead of the ego within which agents act
BESIDE = (1.8, 5.5)  # [m] to the side of the ego, where agents can cut in
SAME_LANE = 1.8  # [m] to the side of the ego up to which an agent is in its lane


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
        ahead, left = to_body(dx, dy, log.yaw[egos, steps])
        same_way = np.cos(log.yaw[:, steps] - log.yaw[egos, steps]) > 0.7
        in_front, aside = there & same_way & (ahead > 0.0) & (ahead < AHEAD_M), np.abs(left)
        beside = in_front & (aside > BESIDE[0]) & (aside < BESIDE[1])
        return cls(ahead, left, there, in_front & (aside < SAME_LANE), beside)


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
