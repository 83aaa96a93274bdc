"""Passing in closed loop: who is held behind a slow ego takes the lane beside, and comes back to its log."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.batched import record_batch
from litsim_eval.runs.in_process import record
from litsim_policy.conflict.diverged import DivergedAgents, DivergedNow
from litsim_policy.conflict.passing import PATIENCE, Passing
from litsim_policy.motion.reference_path import logged_path
from litsim_policy.motion.route import Router
from litsim_sim.core.scene import Controller
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverState
from litsim_sim.record.run import Run
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

EGO, HELD = 1, 2
SPEED = 16.0  # [m/s] of the log; the ego makes 10
STEPS = 230
KINEMATIC = {"predictor": {"model": "kinematic"}}


@pytest.fixture
def behind_slow_ego(make_scenario, track, lane_centres) -> Callable[..., Scenario]:
    """The ego in the middle of three lanes, one 30 m behind it in the same lane, and others as they are given."""

    def make(*others: dict[str, float]) -> Scenario:
        tracks = [
            track(EGO, x=60.0, y=lane_centres[1], speed=SPEED, last=STEPS),
            track(HELD, x=30.0, y=lane_centres[1], speed=SPEED, last=STEPS),
            *(track(**({"speed": SPEED, "last": STEPS} | other)) for other in others),
        ]
        return make_scenario(*tracks, history_steps=10, simulation_s=22.0, coverage_min=0.0)

    return make


def run(scenario: Scenario, policy: str, *, passing: bool = True, **conflict: Any) -> Run:
    parameters = KINEMATIC | {"conflict": {"passing": passing} | conflict}
    return record(RunPlan(scenario, "idm", policy, parameters=parameters))


def on_lane_paths(of: Run) -> set[int]:
    return {t.agent for each in of.takeovers.values() for t in each if t.path_source == PathSource.LANE}


def ahead_of_ego(of: Run) -> float:
    """How far [m] the one who was held is ahead of the ego when it is last on the road."""
    table = next(t for t in reversed(of.tables) if t.row(HELD) >= 0 and t.row(EGO) >= 0)
    return float(table.x[table.row(HELD)] - table.x[table.row(EGO)])


def test_a_driver_held_behind_a_slow_ego_passes_and_is_handed_back(behind_slow_ego, lane_centres) -> None:
    scenario = behind_slow_ego()
    passed, held = run(scenario, "yield"), run(scenario, "yield", passing=False)
    metrics = compute_metrics(passed)
    assert metrics["collision"]["pairs"] == 0
    assert on_lane_paths(passed) == {HELD} and not on_lane_paths(held)
    whole = [(step, t) for step, each in passed.takeovers.items() for t in each if t.agent == HELD]
    order = list(dict.fromkeys((t.state, t.path_source) for _, t in whole))
    beside = [order.index((state, PathSource.LANE)) for state, source in order if source == PathSource.LANE]
    assert beside and max(beside) < order.index((TakeoverState.HANDBACK, PathSource.LOGGED))
    assert np.diff([step for step, _ in whole]).max() == 1, "one takeover from the first step to the release"
    assert ahead_of_ego(passed) > 10.0
    assert ahead_of_ego(held) < 0.0
    (entry,) = metrics["ledger"]
    assert entry["agent"] == HELD and entry["released_step"] is not None and entry["residual_m"] <= 0.5
    (entry_held,) = compute_metrics(held)["ledger"]
    own = [step for step, each in held.takeovers.items() for t in each if t.state == TakeoverState.OWN_INTENT]
    assert (entry_held["released_step"], entry_held["outcome"]) == (None, "own_intent")
    assert own == list(range(entry_held["own_intent_step"], held.tables[-1].step + 1)), "no conflict since"
    after = next(t for t in passed.tables if t.step == entry["released_step"] + 40)
    row = after.row(HELD)
    assert after.controller[row] == Controller.LOG and after.y[row] == pytest.approx(lane_centres[1], abs=0.2)


def test_nobody_passes_where_there_is_no_room(behind_slow_ego, lane_centres) -> None:
    beside = [
        {"id": 10 + 20 * lane + k, "x": 20.0 + 11.0 * k - 88.0, "y": lane_centres[2 * lane], "speed": 12.0}
        for lane in (0, 1)
        for k in range(20)
    ]
    found = run(behind_slow_ego(*(each for each in beside if each["x"] > 0.0)), "yield")
    assert HELD in {t.agent for each in found.takeovers.values() for t in each}
    assert HELD not in on_lane_paths(found)


def test_who_comes_back_waits_for_room_in_its_own_lane(behind_slow_ego, lane_centres) -> None:
    """Two pass one after the other; nobody is touched, and both are back on their logs."""
    found = run(behind_slow_ego({"id": 3, "x": 5.0, "y": lane_centres[1]}), "yield")
    metrics = compute_metrics(found)
    assert metrics["collision"]["pairs"] == 0 and on_lane_paths(found) == {HELD, 3}
    assert all(entry["released_step"] is not None for entry in metrics["ledger"])


def test_scenes_that_are_joined_pass_as_alone(behind_slow_ego, lane_centres) -> None:
    scenes = [behind_slow_ego(), behind_slow_ego({"id": 3, "x": 5.0, "y": lane_centres[2]})]
    plans = [RunPlan(scene, "idm", "litsim", parameters=KINEMATIC) for scene in scenes]
    alone, together = [record(plan) for plan in plans], record_batch(plans)
    assert [compute_metrics(each)["digest"] for each in alone] == [compute_metrics(each)["digest"] for each in together]
    assert all(on_lane_paths(each) for each in alone)


@pytest.mark.parametrize(
    ("beside", "goes_on"), [({"x": 90.0}, True), ({"x": 31.0}, False), ({"x": 18.0, "speed": 26.0}, False)]
)
def test_a_change_that_has_begun_is_given_up_where_somebody_is_or_closes_in(
    behind_slow_ego, placed, lane_centres, beside, goes_on
) -> None:
    scenario = behind_slow_ego({"id": 3, "y": lane_centres[0]} | beside)
    lane_map = scenario.lane_map
    table = placed(scenario.log.table(0), HELD, speed=SPEED)
    row = table.row(HELD)
    pose = np.array([table.x[row], table.y[row], table.yaw[row]])
    lane = lane_map.row(str(lane_map.lanes[int(lane_map.nearest(*pose[:, None]).lane[0])].left))
    router = Router(lane_map)
    logged = logged_path(scenario.log, lane_map, HELD)
    off = DivergedAgents.opened(HELD, EGO, 0, TakeoverReason.CONFLICT, pose, (logged, PathSource.ROUTE, logged))
    path = router.beside(pose, 50.0, lane)
    assert path is not None and path.points[0] == pytest.approx(pose[:2])
    off.pass_along(0, path, lane, 0)
    assert (off.beside[0], off.source[0], off.changed_step[0]) == (lane, PathSource.LANE, 0)
    Passing(lane_map, router).change_lanes(DivergedNow.at(scenario.log, off, table, np.zeros(len(table), np.int64)))
    assert (off.source[0] == PathSource.LANE) == goes_on
    assert (off.beside[0] == lane) == goes_on and (off.path[0] is logged) != goes_on


SPLIT = 389.0  # [m] x where the rightmost of six lanes becomes the ramp, the others the road on, in us101_like
RAMP_LANE, NEXT_LANE, THIRD_LANE = "weave_0", "weave_1", "weave_2"


@pytest.fixture
def before_ramp(make_scenario, track, placed) -> Callable[..., Any]:
    """One off its log before the ramp, in some lane and at some x, whose log is in the lane next to that of the ramp.

    Returns what it does at a look for lanes, and what is needed to ask more.
    """

    def make(lane: str, x: float, *others: tuple[str, float], passes: bool = False, speed: float = 8.0):
        def y(name: str, at: float) -> float:
            return float(lane_map.pose_at(lane_map.row(name), at - 176.0)[1])

        lane_map = make_scenario(track(EGO, x=20.0)).lane_map
        tracks = [track(HELD, x=x, y=y(NEXT_LANE, x), speed=SPEED, last=60), track(EGO, x=20.0, last=60)]
        tracks += [track(10 + k, x=at, y=y(name, at), speed=6.0, last=60) for k, (name, at) in enumerate(others)]
        scenario = make_scenario(*tracks, coverage_min=0.0)
        logged = logged_path(scenario.log, lane_map, HELD)
        table = replace(placed(scenario.log.table(0), HELD, y=y(lane, x), speed=speed), step=50)
        row = table.row(HELD)
        pose = np.array([table.x[row], table.y[row], table.yaw[row]])
        off = DivergedAgents.opened(HELD, EGO, 0, TakeoverReason.CONFLICT, pose, (logged, PathSource.ROUTE, logged))
        off.slowed[:] = PATIENCE
        if passes:
            path = Router(lane_map).beside(pose, 20.0, lane_map.row(lane))
            off.pass_along(0, path, lane_map.row(lane), 0)
        passing = Passing(lane_map, Router(lane_map))
        now = DivergedNow.at(scenario.log, off, table, np.zeros(len(table), np.int64))
        passing.change_lanes(now)
        taken = None if off.beside[0] < 0 else lane_map.lanes[off.beside[0]].id
        return taken, passing, now

    return make


def test_nobody_passes_in_a_lane_that_is_about_to_lead_elsewhere(before_ramp) -> None:
    blocked = [(NEXT_LANE, 30.0), (THIRD_LANE, 5.0), (THIRD_LANE, -8.0)]
    far, near = SPLIT - 170.0, SPLIT - 130.0
    assert before_ramp(NEXT_LANE, far, *((lane, far + gap) for lane, gap in blocked))[0] == RAMP_LANE
    assert before_ramp(NEXT_LANE, near, *((lane, near + gap) for lane, gap in blocked))[0] is None
    assert before_ramp(NEXT_LANE, near, *((lane, near + gap) for lane, gap in blocked[:1]))[0] == THIRD_LANE


def test_who_passes_in_a_lane_that_is_about_to_lead_elsewhere_goes_back_where_there_is_room(before_ramp) -> None:
    """Though nobody is ahead of it there, so that there is nothing to be gained."""
    assert before_ramp(RAMP_LANE, SPLIT - 160.0, passes=True, speed=SPEED)[0] == RAMP_LANE
    near = SPLIT - 140.0
    assert before_ramp(RAMP_LANE, near, passes=True, speed=SPEED)[0] == NEXT_LANE
    assert before_ramp(RAMP_LANE, near, (NEXT_LANE, near + 1.0), passes=True, speed=SPEED)[0] == RAMP_LANE


def test_who_has_passed_onto_another_road_is_not_handed_back(before_ramp) -> None:
    """From the ramp the way to the log leads over the grass between."""

    def may_return(x: float) -> bool:
        _, passing, now = before_ramp(RAMP_LANE, x, passes=True, speed=SPEED)
        now = replace(now, log_x=now.x, log_y=np.full(1, -16.47), log_yaw=np.zeros(1))
        return bool(passing.may_return(now, np.ones(1, np.bool_))[0])

    assert may_return(SPLIT - 160.0)
    off_ramp = SPLIT + 40.0
    assert not may_return(off_ramp)
