"""Mixed traffic: agents behind an ego that brakes come late to where walkers and cyclists cross by their logs."""

from __future__ import annotations

import numpy as np
import pytest

from litsim_sim.core.scene import OBSTACLE_KINDS, Controller, Kind

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
