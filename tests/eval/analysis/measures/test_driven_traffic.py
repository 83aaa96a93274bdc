"""How agents drive under control, in their logs and in all of the log: planted drivers with known figures."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.measures.driven_traffic import QUANTITIES, Traffic, driven_traffic, traffic
from litsim_sim.core import steps
from litsim_sim.core.scene import AgentTable, Controller, Kind
from litsim_sim.core.steps import Steps
from litsim_sim.scenario.scenario import packaged
from made_runs import make_run, moved, table

NET = packaged("nets/us101_like.net.xml").read_bytes()
LEADER, FOLLOWER = 1, 2
LANE, NEXT_LANE = -1.83, -5.49  # [m]
STEPS = 101


def pair(headway: float, **of_follower: Any) -> list[AgentTable]:
    """A leader at 10 m/s and a follower behind it."""
    own = {"id": FOLLOWER, "x": 20.0 - 10.0 * headway - 4.0, "y": LANE} | of_follower
    return [
        table(k, {"id": LEADER, "x": 20.0 + k, "y": LANE}, own | {"x": own["x"] + 0.1 * own.get("speed", 10.0) * k})
        for k in range(STEPS)
    ]


def of_one(of_step: Callable[[int], dict[str, Any]], numbers: Iterable[int] = range(STEPS)) -> Traffic:
    """The driving of an agent that the policy drives."""
    row = {"id": FOLLOWER, "x": 0.0, "y": LANE, "controller": Controller.POLICY}
    return traffic(Steps(table(k, row | of_step(k)) for k in numbers), None, driven=True)


def test_a_tailgater_is_told_from_its_log() -> None:
    log = pair(headway=1.5)
    run = make_run(pair(headway=0.3, controller=Controller.POLICY), log, history_steps=10)
    measured = driven_traffic(run, {FOLLOWER})
    driven, same_log = measured["driven"], measured["same_log"]
    assert (driven["headway_s"], driven["gap_m"]) == pytest.approx((0.3, 3.0))
    assert (same_log["headway_s"], same_log["gap_m"]) == pytest.approx((1.5, 15.0))
    assert (driven["headway_below_half_s"], same_log["headway_below_half_s"]) == (1.0, 0.0)
    assert measured["headway_ratio"] == pytest.approx(0.2)
    assert driven["minutes"] == pytest.approx(90 / 600)


def test_who_drives_as_logged_has_the_measures_of_the_log() -> None:
    log = [
        table(
            k,
            {"id": LEADER, "x": 20.0 + 0.9 * k, "y": LANE, "speed": 9.0},
            {"id": FOLLOWER, "x": k, "y": NEXT_LANE + 3.66 * min(1.0, k / 50), "speed": 10.0 - 0.05 * (k % 20)},
        )
        for k in range(STEPS)
    ]
    run = make_run(moved(log, FOLLOWER, controller=Controller.POLICY), log, net_xml=NET)
    measured = driven_traffic(run, {FOLLOWER})
    assert measured["driven"] == measured["same_log"] != measured["log"]
    assert measured["driven"]["lane_changes"] == 1 and measured["headway_ratio"] == 1.0
    assert None not in measured["driven"].values()


def test_closing_on_the_leader_counts_once_it_is_near_in_time() -> None:
    """At 5 m/s, 30 m are 6 s: half of the time until contact is below 3 s."""
    closing = traffic(Steps(pair(headway=3.0, speed=15.0)[:60]), None).of({FOLLOWER}).measures()
    assert closing["ttc_below_3_s"] == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(
    "follower", [{"speed": 0.5}, {"yaw": np.pi / 2, "x": 15.0}, {"kind": Kind.BICYCLE}, {"y": LANE + 3.66}]
)
def test_who_does_not_follow_has_no_headway(follower: dict[str, Any]) -> None:
    alone = traffic(Steps(pair(headway=1.0, **follower)), None).of({FOLLOWER}).measures()
    assert (alone["following"], alone["headway_s"], alone["ttc_below_3_s"]) == (0, None, None)


def test_accelerations_are_changes_of_speed_over_a_second() -> None:
    """The speed falls by 3 m/s from step 41 to 50: of every fifth step, those of 45, 50 and 55 are 1.5, 3 and 1.5."""
    braking = of_one(lambda k: {"speed": 10.0 - 0.3 * min(max(k - 40, 0), 10)})
    values = braking.samples["acceleration"].value
    assert sorted(values.tolist())[:4] == pytest.approx([-3.0, -1.5, -1.5, 0.0])
    assert braking.measures()["braking_beyond_2_mps2"] == pytest.approx(1 / len(values))
    assert braking.samples["jerk"].value.min() == pytest.approx(-3.0)


def test_a_takeover_or_lost_steps_are_no_change_of_speed() -> None:
    def slower(k: int) -> dict[str, Any]:
        return {"speed": 10.0 if k < 50 else 5.0, "controller": Controller.LOG if k < 50 else Controller.POLICY}

    taken_over = of_one(slower)
    assert set(taken_over.samples["acceleration"].value) == {0.0}
    lossy = of_one(lambda k: {"speed": 0.1 * k}, [*range(40), *range(60, STEPS)])
    assert lossy.samples["acceleration"].value == pytest.approx(1.0)


def test_a_swerve_is_no_lane_change() -> None:
    def run(way: Callable[[int], float]) -> Any:
        rows = [{"id": 2, "x": k, "y": way(k), "controller": Controller.POLICY} for k in range(STEPS)]
        return make_run([table(k, row) for k, row in enumerate(rows)], net_xml=NET)

    def changes(way: Callable[[int], float]) -> int | None:
        return driven_traffic(run(way), {2})["driven"]["lane_changes"]

    assert changes(lambda k: LANE - 3.66 * min(1.0, k / 50)) == 1
    assert changes(lambda k: LANE - 2.2 * np.sin(np.pi * min(k, 25) / 25)) == 0


def test_blocks_of_steps_count_everything_once(monkeypatch: pytest.MonkeyPatch) -> None:
    sides = [table(k, {"id": 2, "x": k, "y": LANE - 1.83 * (1.0 - np.cos(np.pi * k / 75))}) for k in range(301)]
    run = make_run(sides, net_xml=NET)
    whole = driven_traffic(run, {2})["log"]
    monkeypatch.setattr(steps, "BLOCK_ROWS", 7)
    assert driven_traffic(make_run(sides, net_xml=NET), {2})["log"] == whole
    assert whole["lane_changes"] == 4


def test_where_nobody_is_driven_there_is_nothing_to_measure() -> None:
    measured = driven_traffic(make_run(pair(headway=1.0)), set())
    assert measured["driven"] == measured["same_log"]
    assert {measured["driven"][name] for name in ("headway_s", "jerk_mps3", "lane_changes")} == {None}
    assert measured["log"]["headway_s"] == pytest.approx(1.0) and measured["headway_ratio"] is None
    assert set(traffic(Steps(()), None).samples) == set(QUANTITIES)
