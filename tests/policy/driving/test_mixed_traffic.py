"""Mixed traffic: vehicles that come late to where walkers and cyclists cross, and an ego that stands there."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from driven_runs import Driven
from litsim_eval.analysis.measures.takeover import jump
from litsim_sim.core.scene import OBSTACLE_KINDS, STEP_S, AgentTable, Controller, Kind
from litsim_sim.core.takeover import TakeoverState

SPEED, GAP = 12.0, 36.0  # [m/s], [m] of the queue
CROSSING = 350.0  # [m] where the walker crosses, in the middle between agents 2 and 3


@pytest.mark.parametrize("kind", OBSTACLE_KINDS)
@pytest.mark.parametrize("policy", ["yield", "litsim"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_agents_that_come_late_touch_nobody_who_crosses(
    make_scenario, track, drive, lane_centres, policy: str, kind: Kind, side: float
) -> None:
    y, walks = lane_centres[1], 2.0
    queue = [track(1 + k, x=300.0 - GAP * k, y=y, speed=SPEED, last=150) for k in range(4)]
    time = (CROSSING - 300.0 + 1.5 * GAP) / SPEED
    way = {"x": CROSSING, "y": y - side * walks * time, "yaw": side * np.pi / 2, "speed": walks}
    crosses = track(9, last=150, kind=kind, length=0.8, width=0.6, **way)
    run = drive(make_scenario(*queue, crosses), lambda table, _: (-3.5 if table.step < 30 else 1.0, 0.0), policy=policy)
    assert (run.series(2, "controller") == Controller.POLICY).any()
    assert not [pair for pair in run.world.contacts if 9 in pair and 1 not in pair]


@dataclass(frozen=True)
class Stop:
    """A drive of the ego that stops at `x` [m], stands until step `until`, and goes on."""

    x: float
    until: int

    def __call__(self, table: AgentTable, row: int) -> tuple[float, float]:
        if table.step >= self.until:
            return 2.0, 0.0
        return -min(4.0, 0.5 * float(table.speed[row]) ** 2 / max(self.x - float(table.x[row]), 0.01)), 0.0


def largest_jump(run: Driven, agent: int) -> float:
    """Returns the largest jump of an agent's position [m]."""
    steps = pairwise(result.table for result in run.results)
    return max(jump(a, b, agent, STEP_S).position for a, b in steps if min(a.row(agent), b.row(agent)) >= 0)


@pytest.mark.parametrize("kind", OBSTACLE_KINDS)
@pytest.mark.parametrize("policy", ["yield", "litsim"])
@pytest.mark.parametrize("angle", [0.5 * np.pi, -0.5 * np.pi, 0.8 * np.pi])
def test_walkers_and_cyclists_wait_for_who_stands_in_their_way(
    make_scenario, track, drive, lane_centres, policy: str, kind: Kind, angle: float
) -> None:
    speed, length = (1.4, 0.5) if kind == Kind.PEDESTRIAN else (5.0, 1.8)
    ego = track(1, x=300.0, y=lane_centres[1], speed=SPEED, last=250)
    way = 10.0 * speed * np.array([np.cos(angle), np.sin(angle)])  # to the middle of the lane, in 10 s
    start = {"x": CROSSING - way[0], "y": lane_centres[1] - way[1], "yaw": angle, "speed": speed}
    crosses = track(9, last=250, kind=kind, length=length, width=0.6, **start)
    scenario, stop = make_scenario(ego, crosses), Stop(CROSSING, until=140)
    on_log = drive(scenario, stop, policy=policy, parameters={"conflict": {"walkers": False}})
    run = drive(scenario, stop, policy=policy)
    assert on_log.world.contacts and not run.world.contacts
    assert run.life(9)[-1] == TakeoverState.RELEASED
    assert largest_jump(run, 9) < 0.02
