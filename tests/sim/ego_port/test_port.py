"""The ego port's rules, message by message, without DDS."""

import re
from dataclasses import replace
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.errors import DIGITS_MAX, LONGEST
from litsim_sim.core.scene import STEP_NS, EgoCommand, EgoMode
from litsim_sim.core.topic_names import Interface
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.ego_port.answer import Answer
from litsim_sim.ego_port.port import COUNTS, AnswerInvalid, EgoPort, Level
from litsim_sim.ego_port.tracking import EgoState, Trajectory, TwistTarget


def state(step: int, speed: float = 10.0) -> EgoState:
    return EgoState(0.1 * step, speed * 0.1 * step, 0.0, 0.0, speed, 4.5)


def control(step: int, acceleration: float = -1.0, run_id: str = "run") -> Answer:
    return Answer(Interface.CONTROL, EgoCommand(step, acceleration, 0.01), step=step, run_id=run_id)


def twist(step: int, speed: float = 10.0, frame: str = "ego", off_ns: int = 0) -> Answer:
    return Answer(Interface.TWIST, TwistTarget(speed, 0.0), step * STEP_NS + off_ns, frame=frame)


def trajectory(step: int, speed: float = 10.0, frame: str = "map") -> Answer:
    time = 0.1 * step + 0.1 * np.arange(31)
    path = Trajectory(time, 1.0 * step + speed * (time - time[0]), np.zeros(31))
    return Answer(Interface.TRAJECTORY, path, step * STEP_NS, frame=frame)


def port(interface: str = "auto", at: int = 20, **options: Any) -> EgoPort:
    made = EgoPort("run", VehicleModel(), interface, **options)
    made.open(at, state(at), driven=True)
    made.ask()
    return made


def counts(of: EgoPort) -> dict[str, int]:
    assert of.counts.keys() <= set(COUNTS)
    return {name: n for name, n in of.counts.items() if n}


@pytest.mark.parametrize(
    ("answer", "command"),
    [
        (control(20), EgoCommand(20, -1.0, 0.01)),
        (twist(20, 10.1), EgoCommand(20, 1.0, 0.0)),
        (trajectory(20), EgoCommand(20, 0.0, 0.0)),
    ],
)
def test_the_first_message_fixes_the_interface(answer: Answer, command: EgoCommand) -> None:
    at = port()
    assert at.missing
    assert at.topics == ("/litsim/ego/control", "/litsim/ego/twist", "/litsim/ego/trajectory")
    at.offer(answer)
    assert not at.missing
    assert at.topics == (f"/litsim/ego/{answer.interface}",)
    taken = at.take()
    assert (taken.acceleration, taken.yaw_rate) == pytest.approx((command.acceleration, command.yaw_rate), abs=1e-9)
    assert taken.step == 20
    (other,) = ({Interface.CONTROL: twist(20), Interface.TWIST: control(20)}.get(answer.interface, control(20)),)
    at.offer(other)
    assert counts(at) == {"answered": 1, "refused": 1}
    assert [r.level for r in at.remarks] == [Level.OK, Level.ERROR]
    assert f"ignored, /litsim/ego/{answer.interface} is in use" in at.remarks[1].text


def test_an_interface_that_was_chosen_takes_no_other() -> None:
    at = port("trajectory")
    at.offer(twist(20))
    assert at.missing
    at.offer(trajectory(20))
    assert not at.missing


@pytest.mark.parametrize("kind", [control, twist, trajectory])
def test_answers_to_other_steps(kind: Any) -> None:
    at = port(at=19)
    at.offer(kind(19))
    at.open(20, state(20), driven=True)
    at.ask()
    at.offer(kind(15))
    at.offer(kind(19))
    at.offer(kind(21))
    assert at.missing
    at.offer(kind(20))
    at.offer(kind(20))
    at.offer(kind(20))
    assert counts(at) == {"answered": 2, "stale": 2, "future": 1, "surplus": 2}
    at.ask()  # the step is published again: one more is asked for
    at.offer(kind(20))
    assert at.counts["surplus"] == 2
    assert at.take().step == 20


def test_answers_to_repetitions_of_the_step_before_are_still_to_come() -> None:
    at = port()
    for _ in range(2):
        at.ask()
    at.offer(twist(20))
    at.open(21, state(21), driven=True)
    at.ask()
    assert at.behind == 2
    at.offer(twist(20))
    assert (at.behind, at.missing) == (1, True)
    at.offer(twist(21))
    assert at.behind == 0
    assert counts(at) == {"answered": 2}


@pytest.mark.parametrize(
    ("off_ns", "kind"),
    [(0, "answered"), (900_000, "answered"), (-900_000, "answered"), (5_000_000, "future"), (-5_000_000, "stale")],
)
def test_a_stamp_may_miss_its_step_by_a_rounding(off_ns: int, kind: str) -> None:
    at = port()
    at.offer(twist(20, off_ns=off_ns))
    assert counts(at) == {kind: 1}


def test_another_run_is_stale_and_before_the_first_step_nothing_counts() -> None:
    at = EgoPort("run", VehicleModel())
    at.offer(twist(0))
    assert at.interface is None
    at.open(0, state(0), driven=False)
    at.offer(control(0, run_id="another"))
    assert at.missing
    assert counts(at) == {"stale": 1}
    assert "an answer to run 'another'" in at.remarks[-1].text


def test_a_message_of_another_run_does_not_decide_the_interface() -> None:
    at = port()
    at.offer(control(20, run_id="another"))
    assert at.interface is None and len(at.topics) == 3
    assert counts(at) == {"stale": 1}
    at.offer(twist(20))
    assert not at.missing
    at.offer(control(20, run_id="another"))
    assert counts(at) == {"stale": 2, "answered": 1}


def test_a_late_answer_is_held_from_then_on() -> None:
    at = port()
    at.offer(control(20, -1.0))
    at.open(21, state(21), driven=True)
    assert at.take() == EgoCommand(21, -1.0, 0.01)  # missed: the last one
    at.open(22, state(22), driven=True)
    at.offer(control(21, -3.0))
    assert at.missing
    assert at.take() == EgoCommand(22, -3.0, 0.01)
    assert counts(at) == {"answered": 2, "late": 1}
    assert "late by 1 steps" in at.remarks[-1].text


def test_a_held_trajectory_is_tracked_on() -> None:
    at = port()
    speeding_up = trajectory(20)
    speeding_up.target.x[:] += 0.5 * (speeding_up.target.time - 2.0) ** 2  # type: ignore[union-attr]
    at.offer(speeding_up)
    assert at.take().acceleration == pytest.approx(1.0, abs=0.3)
    at.open(30, replace(state(30), x=30.5, speed=11.0), driven=True)
    assert at.take().acceleration == pytest.approx(1.0, abs=0.3)
    at.open(50, replace(state(50), x=54.5, speed=13.0), driven=True)
    assert at.take().acceleration == -2.0  # it is over


BAD = [
    (control(20, nan), "acceleration is nan, expected a finite value"),
    (twist(20, inf), "twist.linear.x is inf, expected a finite value"),
    (twist(20, frame="map"), "frame_id is 'map', expected that of the ego's body, ego or base_link"),
    (trajectory(20, frame="base_link"), "frame_id is 'base_link', expected 'map'"),
    (trajectory(20, speed=nan), "pose 0 is not finite: nan, 0.0"),
    (trajectory(20, speed=90.0), "it jumps by 9.00 m within 0.1 s up to 2.1 s, expected at most 1.3"),
    (
        Answer(Interface.TRAJECTORY, Trajectory(*np.zeros((3, 4))), 20 * STEP_NS),
        "stamps of poses 0 and 1 are 0 and 0 s",
    ),
    (Answer(Interface.TRAJECTORY, Trajectory(*np.zeros((3, 0))), 20 * STEP_NS), "it holds no poses"),
    (
        Answer(Interface.CONTROL, None, step=20, run_id="run", fault="mode is 7"),
        "mode is 7",
    ),
]


@pytest.mark.parametrize(("answer", "why"), BAD)
def test_an_answer_that_is_no_use_stops(answer: Answer, why: str) -> None:
    at = port()
    at.offer(answer)
    assert not at.missing
    assert counts(at) == {"invalid": 1}
    assert (at.remarks[-1].level, at.remarks[-1].step) == (Level.ERROR, 20)
    assert f"cannot be used: {why}" in at.remarks[-1].text
    with pytest.raises(AnswerInvalid) as error:
        at.take()
    said = f"the answer to step 20 on /litsim/ego/{answer.interface} cannot be used: {why}"
    assert str(error.value).startswith(said)


@pytest.mark.parametrize(
    "answer",
    [
        twist(20, frame="\x1b[2J" + 2_000_000 * "m"),
        trajectory(20, frame=2_000_000 * "m"),
        replace(control(20), run_id=2_000_000 * "r"),
        replace(control(20), fault=2_000_000 * "f"),
        trajectory(20, speed=1e307),
        replace(control(20), step=10**300),
    ],
)
def test_whatever_an_answer_holds_what_is_said_about_it_is_short(answer: Answer) -> None:
    at = port()
    at.offer(answer)
    texts = [remark.text for remark in at.remarks] + [at.unfit]
    try:
        at.take()
    except AnswerInvalid as error:
        texts.append(str(error))
    assert any(texts) and all(len(text) < 1.2 * LONGEST and text.isprintable() for text in texts)
    assert all(len(digits) <= DIGITS_MAX for text in texts for digits in re.findall("[0-9]+", text))


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (twist(21, nan), "twist.linear.x is nan, expected a finite value"),
        (twist(21, frame="odom"), "frame_id is 'odom'"),
    ],
)
def test_so_does_a_late_one_that_is_no_use_by_itself(answer: Answer, why: str) -> None:
    at = port()
    at.offer(twist(20))
    at.open(45, state(45), driven=True)
    at.offer(answer)
    assert at.missing
    assert counts(at) == {"answered": 1, "late": 1, "invalid": 1}
    with pytest.raises(AnswerInvalid) as error:
        at.take()
    assert str(error.value).startswith(f"the answer to step 21 on /litsim/ego/twist cannot be used: {why}")


def test_but_not_one_that_has_come_too_late() -> None:
    """As it is over: in real time, the stack may be fast again."""
    time = 2.1 + 0.1 * np.arange(20)
    over = Answer(Interface.TRAJECTORY, Trajectory(time, 10.0 * time, np.zeros(20)), 21 * STEP_NS)
    at = port("trajectory")
    at.offer(trajectory(20))
    at.open(45, state(45), driven=True)
    at.offer(over)
    assert counts(at) == {"answered": 1, "late": 1, "invalid": 1}
    assert at.take().step == 45


@pytest.mark.parametrize(("answer", "why"), BAD)
def test_or_the_last_good_one_is_held(answer: Answer, why: str) -> None:
    at = port(at=19, stop_on_invalid=False)
    good = {Interface.CONTROL: control, Interface.TWIST: twist, Interface.TRAJECTORY: trajectory}[answer.interface](19)
    at.offer(good)
    before = at.take()
    at.open(20, state(20), driven=True)
    at.offer(answer)
    held = at.take()
    assert held == replace(before, step=20) if answer.interface == Interface.CONTROL else held.step == 20
    assert (held.acceleration, held.yaw_rate) == pytest.approx((before.acceleration, before.yaw_rate), abs=1e-6)
    assert counts(at) == {"answered": 1, "invalid": 1}


def test_with_nothing_to_hold_the_ego_rolls_on() -> None:
    at = port(stop_on_invalid=False)
    at.offer(twist(20, nan))
    assert at.take() == EgoCommand(20)


def test_in_the_history_a_trajectory_may_be_empty_and_nothing_is_tracked() -> None:
    at = EgoPort("run", VehicleModel())
    at.open(3, state(3), driven=False)
    at.offer(Answer(Interface.TRAJECTORY, Trajectory(*np.zeros((3, 0))), 3 * STEP_NS))
    assert not at.missing
    assert at.take() == EgoCommand(3)
    assert counts(at) == {"answered": 1}


@pytest.mark.parametrize("kind", [control, twist, trajectory])
def test_the_last_answer_of_the_history_is_held(kind: Any) -> None:
    """In real time, the first answer that counts may be late."""
    at = EgoPort("run", VehicleModel())
    at.open(29, state(29), driven=False)
    at.offer(kind(29))
    at.open(30, replace(state(30), speed=10.5), driven=True)
    held = at.take()
    assert held.acceleration == pytest.approx({control: -1.0, twist: -5.0, trajectory: -2.0}[kind])


def test_an_ego_that_follows_its_log_or_has_left() -> None:
    at = port()
    at.offer(replace(control(20), target=EgoCommand(20, mode=EgoMode.FOLLOW_LOG)))
    assert at.take().mode == EgoMode.FOLLOW_LOG
    gone = port("twist")
    gone.open(21, None, driven=False)
    gone.offer(twist(21))
    assert gone.take() == EgoCommand(21)


def test_the_same_thing_is_said_now_and_then() -> None:
    at = port()
    for step in range(20, 45):
        at.open(step, state(step), driven=True)
        for _ in range(50):
            at.offer(twist(step + 3))
        at.offer(twist(step))
    future = [remark.step for remark in at.remarks if "of the future" in remark.text]
    assert future == [20, 30, 40]
    assert at.counts["future"] == 25 * 50
    assert "(1001 so far)" in at.remarks[-1].text


def answered(at: EgoPort, step: int, *answers: Answer) -> float:
    """The acceleration commanded at a step, once these answers have come."""
    at.open(step, state(step), driven=True)
    at.ask()
    for answer in answers:
        at.offer(answer)
    return at.take().acceleration


def test_an_answer_counts_later_by_the_latency() -> None:
    at = EgoPort("run", VehicleModel(), latency="0.2")
    commanded = [answered(at, k, control(k, -float(k))) for k in range(20, 25)]
    assert commanded == [0.0, 0.0, -20.0, -21.0, -22.0]
    assert not at.missing and counts(at) == {"answered": 5}
    assert answered(at, 25) == -23.0, "a missed answer: those before still come into force"
    assert [answered(at, 26, control(25, -25.0), control(26, -26.0)), answered(at, 27)] == [-24.0, -25.0]


def test_a_twist_is_reached_from_where_the_ego_is_then() -> None:
    at = EgoPort("run", VehicleModel(), latency="0.1")
    answered(at, 20, twist(20, 10.1))
    at.open(21, state(21, speed=10.05), driven=True)
    assert at.take().acceleration == pytest.approx(0.5)


def test_a_measured_latency_is_that_of_each_answer_to_the_nearest_step() -> None:
    times = iter((0.0, 0.04, 1.0, 1.16, 2.0, 2.01, 3.0, 3.0))  # opened, answered, …
    at = EgoPort("run", VehicleModel(), latency="measured", clock=lambda: next(times))
    commanded = [answered(at, k, control(k, -float(k))) for k in range(20, 24)]
    assert commanded == [-20.0, -20.0, -22.0, -23.0], "160 ms are two steps, and an older answer is not taken then"


def test_a_measured_latency_of_a_missed_step_counts_from_that_step() -> None:
    times = iter((0.0, 0.1, 0.16, 0.2))  # two steps opened, the first answered, a third opened
    at = EgoPort("run", VehicleModel(), latency="measured", clock=lambda: next(times))
    assert [answered(at, 20), answered(at, 21, control(20, -20.0)), answered(at, 22)] == [0.0, 0.0, -20.0]


@pytest.mark.parametrize("latency", ["0.25", "-0.1", "soon", "nan", "61"])
def test_a_latency_that_is_none(latency: str) -> None:
    with pytest.raises(ValueError, match=f"latency is {latency}, expected measured, or a multiple of 0.1 s from 0 to"):
        EgoPort("run", VehicleModel(), latency=latency)
