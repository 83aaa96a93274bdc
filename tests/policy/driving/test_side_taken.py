"""Policy litsim beside others: who would leave its lane where somebody else is waits in it, and no guard is needed."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.driving.policy_c import PolicyC
from litsim_sim.core.scene import ControlSource
from litsim_sim.core.takeover import TakeoverTable
from takeovers import takeover

LEFT, RIGHT = 0.5, -0.5
WIDE = 3.66  # [m] from lane to lane


@pytest.fixture
def yaw_rate(make_scenario, track, lane_centres):
    """Yaw rate of agent 2, which a network steers by `asked`, its path `left` by a lane; and whose command that is.

    Agent 1 is `ahead` of it, so many `lanes` to its left, and `comes` over at that angle [rad].
    """

    def yaw_rate(
        asked: float, ahead: float, left: float = 1.0, lanes: int = 1, comes: float = 0.0
    ) -> tuple[float, ControlSource]:
        y = lane_centres[2]
        beside = track(1, x=100.0 + ahead, y=y + lanes * WIDE, yaw=-comes)
        scenario = make_scenario(beside, track(2, x=100.0, y=y))
        says = SimpleNamespace(
            observation=ObservationConfig(), mean=lambda seen: np.tile([0.0, asked, asked], (len(seen), 1))
        )
        policy = PolicyC(scenario, says)
        path = np.array([[90.0, y], [100.0, y], [125.0, y + left * WIDE], [300.0, y + left * WIDE]])
        table = scenario.log.table(5)
        path[:, 0] += table.x[table.row(2)] - 100.0
        controls = policy.act(table, TakeoverTable(5, (takeover(2, reference_path=path),)))
        return float(controls.yaw_rate[0]), ControlSource(int(controls.source[0]))

    return yaw_rate


def test_it_goes_where_the_side_is_free(yaw_rate) -> None:
    rate, source = yaw_rate(LEFT, ahead=60.0)
    assert rate > 0.05 and source == ControlSource.POLICY


@pytest.mark.parametrize("ahead", [-3.0, 0.0, 3.0])
def test_it_waits_in_its_lane_where_somebody_is_beside(yaw_rate, ahead: float) -> None:
    rate, source = yaw_rate(LEFT, ahead)
    assert rate == pytest.approx(0.0, abs=1e-6) and source == ControlSource.POLICY


def test_away_from_the_one_beside_it_may_steer(yaw_rate) -> None:
    assert yaw_rate(RIGHT, ahead=0.0)[0] < -0.05, "though its path leads there"
    assert yaw_rate(RIGHT, ahead=0.0, left=-1.0)[0] < -0.05, "its path leads to the other side"


def test_it_waits_for_who_comes_over_from_the_lane_after_the_next(yaw_rate) -> None:
    assert yaw_rate(LEFT, ahead=0.0, lanes=2)[0] > 0.05
    rate, source = yaw_rate(LEFT, ahead=0.0, lanes=2, comes=0.2)
    assert rate == pytest.approx(0.0, abs=1e-6) and source == ControlSource.POLICY
