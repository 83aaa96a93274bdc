"""The time gap that a driver usually keeps, learnt from the steps on its log alone."""

from __future__ import annotations

import numpy as np
import pytest

from litsim_policy.motion.usual_gaps import PERIOD, UsualGaps, time_gaps
from litsim_sim.core.scene import Controller

LENGTH, AHEAD = 4.5, 24.5  # [m] between centres, which is 2 s at 10 m/s


def pair(agent_table, step: int = 0, ahead: float = AHEAD, **leader: float):
    return agent_table(step, {"id": 1}, {"id": 2, "x": ahead, **leader})


def test_the_gap_is_from_bumper_to_bumper(agent_table) -> None:
    assert time_gaps(pair(agent_table)) == pytest.approx([(AHEAD - LENGTH) / 10.0, np.inf])


@pytest.mark.parametrize(
    "leader",
    [{"y": 2.1}, {"yaw": 1.0}, {"x": -AHEAD}, {"x": 4.0}, {"x": 40.0}, {"controller": Controller.POLICY}],
    ids=["beside", "crossing", "behind", "touching", "far ahead", "off its log"],
)
def test_who_is_no_leader(agent_table, leader: dict[str, float]) -> None:
    assert time_gaps(pair(agent_table, **leader))[0] == np.inf


@pytest.mark.parametrize("own", [{"speed": 1.0}, {"controller": Controller.POLICY}], ids=["slow", "off its log"])
def test_who_does_not_count(agent_table, own: dict[str, float]) -> None:
    assert time_gaps(agent_table(0, {"id": 1, **own}, {"id": 2, "x": AHEAD}))[0] == np.inf


def test_the_nearest_ahead_leads(agent_table) -> None:
    table = agent_table(0, {"id": 1}, {"id": 2, "x": AHEAD}, {"id": 3, "x": 14.5})
    assert time_gaps(table)[0] == pytest.approx(1.0)


def test_scenes_do_not_see_each_other(agent_table) -> None:
    table = pair(agent_table)
    table.scene = np.array([0, 1])
    assert time_gaps(table)[0] == np.inf


def test_without_looks_the_gap_is_typical_and_with_many_its_own(make_scenario, track, agent_table) -> None:
    usual = UsualGaps(make_scenario(track(1, x=100.0), track(2, x=100.0 + AHEAD)).log)
    assert usual.means(np.array([1, 2]), 1.4, 3.0) == pytest.approx([1.4, 1.4])
    for step in range(3 * PERIOD):
        usual.observe(pair(agent_table, step))
    assert usual.means(np.array([1, 2]), 1.4, 3.0) == pytest.approx([(1.4 + 2.0) / 2, 1.4])
