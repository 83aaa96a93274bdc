"""Each clause of `check_ads` passes what keeps it and fails what breaks it, from evidence made by hand."""

from dataclasses import replace
from math import nan
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from litsim_eval.check_ads.requirements import Clause, Verdict, is_clipped, judge, motion
from litsim_eval.check_ads.trace import Ending, Endpoint, Evidence, Heard
from litsim_sim.core.scene import STEP_NS, EgoCommand
from litsim_sim.core.topic_names import EGO_INPUTS, Interface
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.ego_port.answer import Answer
from litsim_sim.ego_port.tracking import EgoState, Trajectory, TwistTarget
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import packaged

STEPS, SPEED, TOOK_NS, BEGIN_NS = 10, 12.0, 20_000_000, 10**18
VEHICLE = VehicleModel()
PASS, FAIL, OPEN = Verdict.PASS, Verdict.FAIL, Verdict.OPEN
TRAJECTORY = Interface.TRAJECTORY


def state(step: int, y: float) -> EgoState:
    return EgoState(0.1 * step, 100.0 + 0.1 * SPEED * step, y, 0.0, SPEED, 4.5)


def trajectory(ego: EgoState, *, aside: float = 0.0, turned: float = 0.0, bump: float = 0.0) -> Trajectory:
    """Two seconds at constant speed from the ego on: beside it, in another direction, or with a jolt."""
    ahead = 0.1 * np.arange(21)
    x, y = ego.x + SPEED * ahead * np.cos(turned), ego.y + aside + SPEED * ahead * np.sin(turned)
    x[10:] += bump
    return Trajectory(ego.time + ahead, x, y)


@pytest.fixture(scope="module")
def scenario() -> Any:
    lane_map = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    return SimpleNamespace(lane_map=lane_map, vehicle=VEHICLE, total_steps=STEPS, history_steps=0)


@pytest.fixture
def seen(scenario: Any, lane_centres: tuple[float, ...]) -> Evidence:
    """Of a stack that does everything right, with trajectories."""
    states = {step: state(step, lane_centres[1]) for step in range(STEPS + 1)}
    asked = {step: BEGIN_NS + step * STEP_NS for step in states}
    heard = [
        Heard(Answer(TRAJECTORY, trajectory(ego), step * STEP_NS), asked[step] + (step + 1) * TOOK_NS)
        for step, ego in states.items()
    ]
    return Evidence(
        scenario,
        wait_s=30.0,
        discovered_s={TRAJECTORY: 0.5},
        endpoints=(
            Endpoint(EGO_INPUTS[TRAJECTORY], "/stack", publishes=True),
            Endpoint("/litsim/ego/state", "/stack", publishes=False),
        ),
        published_ns={step: [time] for step, time in asked.items()},
        heard=heard,
        interface=TRAJECTORY,
        counts={"answered": STEPS + 1},
        states=states,
        state="FINISHED",
        ending=Ending(watched_s=5.0, last_s=None, present=True),
    )


def in_history(seen: Evidence, steps: int) -> Evidence:
    """The same in a scenario whose history has so many steps."""
    scenario: Any = SimpleNamespace(**vars(seen.scenario) | {"history_steps": steps})
    return replace(seen, scenario=scenario)


def clauses(seen: Evidence, **limits: float) -> dict[str, Clause]:
    return {each.name: each for each in judge(seen, **limits)}


def only(seen: Evidence, name: str, **limits: float) -> str:
    """The reason of the one clause that fails."""
    found = clauses(seen, **limits)
    assert [each.name for each in found.values() if each.verdict == FAIL] == [name]
    return found[name].text


def answered(seen: Evidence, step: int, **fields: Any) -> Evidence:
    """The same, but for the answer to one step."""
    heard = list(seen.heard)
    heard[step] = replace(heard[step], answer=replace(heard[step].answer, **fields))
    return replace(seen, heard=heard)


def test_everything_right(seen: Evidence) -> None:
    found = clauses(seen)
    assert {each.verdict for each in found.values()} == {PASS}
    assert found["answers every step"].text == "11 of 11 steps"
    figures = found["latency"].figures
    assert (figures["min_ms"], figures["median_ms"], figures["max_ms"]) == pytest.approx((40.0, 130.0, 220.0))
    assert figures["within_a_step"] == pytest.approx(0.4)  # steps 1 to 4 of 10; step 0 is where one meets
    assert found["values finite and feasible"].figures["clipped"] == 0


def test_a_stack_begins_anew_if_a_second_run_is_the_same(seen: Evidence) -> None:
    assert "begins anew" not in clauses(seen), "there was no second run"
    assert clauses(replace(seen, difference=""))["begins anew"].verdict == PASS
    assert only(replace(seen, difference="no answer"), "begins anew") == "second run: no answer"


def test_nobody(seen: Evidence) -> None:
    gone = Ending(5.0, None, present=False)
    nothing = replace(
        seen, discovered_s={}, endpoints=(), heard=[], interface=None, counts={}, ending=gone, failure="late"
    )
    found = clauses(nothing)
    assert found.pop("discovery").verdict == FAIL
    assert {each.verdict for each in found.values()} == {OPEN}


def test_another_type_or_qos(seen: Evidence) -> None:
    wrong = replace(seen.endpoints[1], problem="its type is std_msgs/msg/String")
    found = only(replace(seen, endpoints=(seen.endpoints[0], wrong)), "types and QoS")
    assert found == "/litsim/ego/state: its type is std_msgs/msg/String"


def test_a_foreign_publisher_on_an_internal_topic(seen: Evidence) -> None:
    text = "/cheat: publishes on /litsim/controls, expected nobody"
    ended = replace(
        seen,
        intrusions=[text],
        heard=seen.heard[:10],
        counts={"answered": 10},
        state="FAILED",
        failure=text,
    )
    assert only(ended, "keeps to its topics") == text


def test_a_publisher_that_the_bridge_cannot_hear(seen: Evidence) -> None:
    deaf = replace(seen, endpoints=(replace(seen.endpoints[0], problem="BEST_EFFORT"),), failure="no answer")
    assert only(deaf, "types and QoS") == "/litsim/ego/trajectory: BEST_EFFORT"
    assert clauses(deaf)["answers every step"].verdict == OPEN


def test_silence(seen: Evidence) -> None:
    silent = replace(
        seen, heard=seen.heard[:10], counts={"answered": 10}, state="FAILED", failure="no answer to step 10"
    )
    assert only(silent, "answers every step") == "10 of 11 steps; 1 missing, first 10; no answer to step 10"


def test_a_stamp_between_two_steps_answers_neither(seen: Evidence) -> None:
    off = answered(seen, 10, stamp_ns=10 * STEP_NS + 30_000_000)
    missed = replace(off, counts={"answered": 10, "future": 1}, state="FAILED", failure="no answer to step 10")
    found = clauses(missed)
    said = "10 of 11 steps; 1 missing, first 10; 1 from the future; no answer to step 10"
    assert found["answers every step"].text == said
    assert found["latency"].figures["max_ms"] == pytest.approx(200.0)  # of step 9
    nearly = answered(seen, 10, stamp_ns=10 * STEP_NS + 900_000)
    assert clauses(nearly)["answers every step"].verdict == PASS


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        ({"stale": 3}, "3 stale"),
        ({"future": 1}, "1 from the future"),
        ({"surplus": 12}, "12 surplus, more than one per step"),
        ({"refused": 2}, "2 on a second interface"),
    ],
)
def test_answers_that_were_not_asked_for(seen: Evidence, counts: dict[str, int], words: str) -> None:
    found = only(replace(seen, counts=seen.counts | counts), "answers every step")
    assert found == f"11 of 11 steps; {words}"


def test_a_step_that_is_repeated_may_be_answered_again(seen: Evidence) -> None:
    asked = seen.published_ns | {0: seen.published_ns[0] * 4}
    twice = replace(seen, published_ns=asked, counts=seen.counts | {"stale": 3, "surplus": 5})
    assert clauses(twice)["answers every step"].verdict == PASS


def test_slow_answers(seen: Evidence) -> None:
    assert "; expected 95 % within 150 ms" in only(seen, "latency", latency_ms=150.0)


def test_another_frame(seen: Evidence) -> None:
    text = only(answered(seen, 4, frame="odom"), "frames plausible")
    assert text == "1 with another frame, first at step 4: frame_id is 'odom', expected 'map'"


def test_beginning_elsewhere(seen: Evidence) -> None:
    aside = answered(seen, 4, target=trajectory(seen.states[4], aside=3.0))
    text = only(aside, "frames plausible")
    assert text == "1 do not begin at the ego, first at step 4: 3.0 m away, expected at most 2 m"


@pytest.mark.parametrize("fault", ["empty", "aside", "jump"])
def test_in_the_history_trajectories_are_not_used_and_so_not_judged(seen: Evidence, fault: str) -> None:
    ego = seen.states[4]
    target = {
        "empty": Trajectory(*np.zeros((3, 0))),
        "aside": trajectory(ego, aside=3.0),
        "jump": trajectory(ego, bump=10.0),
    }[fault]
    changed = answered(seen, 4, target=target)
    assert FAIL in {each.verdict for each in clauses(changed).values()}
    found = clauses(in_history(changed, 5))
    assert {each.verdict for each in found.values()} == {PASS}
    assert found["values finite and feasible"].figures["judged"] == 6
    assert only(answered(in_history(seen, 5), 4, frame="odom"), "frames plausible")


def test_against_the_road(seen: Evidence) -> None:
    back = answered(seen, 4, target=trajectory(seen.states[4], turned=np.pi))
    said = "1 deviate from the road's direction, first at step 4: 100% of its headings"
    assert said in only(back, "frames plausible")


def test_not_finite(seen: Evidence) -> None:
    target = trajectory(seen.states[4])
    target.y[3] = nan
    text = only(answered(seen, 4, target=target), "values finite and feasible")
    assert text.startswith("1 cannot be used, first at step 4: pose 3 is not finite: ")


def test_a_jump(seen: Evidence) -> None:
    text = only(answered(seen, 4, target=trajectory(seen.states[4], bump=10.0)), "values finite and feasible")
    assert text.startswith("1 cannot be used, first at step 4: it jumps by 11.2")


def test_more_than_the_vehicle_can(seen: Evidence) -> None:
    heard = [
        replace(each, answer=replace(each.answer, target=trajectory(seen.states[step], bump=0.1)))
        for step, each in enumerate(seen.heard)
    ]  # a metre per second more for a tenth of a second: 10 m/s2
    shaken = replace(seen, heard=heard)
    text = "100.0% of 11 answers beyond the vehicle's limits, expected at most 10.0%"
    assert only(shaken, "values finite and feasible") == text
    assert clauses(shaken, clipped=1.0)["values finite and feasible"].verdict == PASS


def test_leaving_in_mid_run(seen: Evidence) -> None:
    left = replace(
        seen,
        heard=seen.heard[:5],
        counts={"answered": 5},
        state="",
        failure="the stack left",
        left=5,
        ending=Ending(1.0, None, present=False, exit_status=3, obituary="stack ended with exit status 3"),
    )
    text = only(left, "end of run")
    assert text == "the stack left at step 5 of 10, before the run was over: stack ended with exit status 3"
    assert clauses(left)["answers every step"].text == "5 of 5 steps, until the stack left"


@pytest.mark.parametrize(
    ("end", "verdict"),
    [
        (Ending(5.0, 0.2, present=True), PASS),
        (Ending(2.0, 0.2, present=False, exit_status=0, obituary="stack ended with exit status 0"), PASS),
        (Ending(5.0, 4.9, present=True), FAIL),
        (Ending(2.0, None, present=False, exit_status=-11, obituary="stack was ended by SIGSEGV"), FAIL),
    ],
)
def test_after_the_run(seen: Evidence, end: Ending, verdict: Verdict) -> None:
    assert clauses(replace(seen, ending=end))["end of run"].verdict == verdict


@pytest.mark.parametrize(
    ("target", "clipped"),
    [
        (EgoCommand(0, 3.9, 0.0), False),
        (EgoCommand(0, 5.0, 0.0), True),
        (EgoCommand(0, 0.0, 0.5), True),  # 6 m/s2 to the side
        (TwistTarget(SPEED + 0.3, 0.1), False),
        (TwistTarget(SPEED - 1.5, 0.0), True),  # 15 m/s2
    ],
)
def test_demands(target: Any, clipped: bool) -> None:
    assert is_clipped(target, state(0, 0.0), VEHICLE) == clipped


def test_a_yaw_rate_need_not_be_possible_at_a_speed_that_slow_actuators_reach_later() -> None:
    assert not is_clipped(TwistTarget(SPEED + 6.0, 0.35), state(0, 0.0), VehicleModel(lag_s=1.0))
    assert is_clipped(TwistTarget(SPEED + 6.0, 0.45), state(0, 0.0), VehicleModel(lag_s=1.0))


def test_motion_along_a_circle() -> None:
    angle, radius = np.linspace(np.pi - 0.2, np.pi + 0.2, 21), 50.0  # its headings go past pi
    circle = Trajectory(0.1 * np.arange(21), radius * np.sin(angle), radius * np.cos(angle))
    speed, acceleration, yaw_rate = motion(circle)
    assert speed == pytest.approx(np.full(19, 10.0), rel=1e-3)
    assert acceleration == pytest.approx(np.zeros(19), abs=1e-6)
    assert yaw_rate == pytest.approx(np.full(19, -0.2), rel=1e-6)


def test_what_the_bridge_says_again_and_again_is_one_remark(seen: Evidence) -> None:
    late = [f"/litsim/ego/twist: the answer to step {k}, at step {k + 1}, is stale ({k} so far)" for k in range(1, 9)]
    other = "/litsim/ego/trajectory: ignored, /litsim/ego/twist is in use (1 so far)"
    for text in (late[0], other, *late):
        seen.remark(text)
    assert seen.remarks == [late[-1], other]
