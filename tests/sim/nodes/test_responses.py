"""What the bridge makes of what comes in: who is ready or silent, which answers count, what a missing one does."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.lockstep import RECORDER_WINDOW
from litsim_sim.core.scene import STEP_NS, ControlTable, EgoCommand
from litsim_sim.core.stages import StageState
from litsim_sim.core.topic_names import Interface
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.ego_port.answer import Answer
from litsim_sim.ego_port.port import EgoPort
from litsim_sim.ego_port.tracking import TwistTarget
from litsim_sim.nodes.ego_publishers import EgoPublisher, EgoPublishers, absence, rivalry
from litsim_sim.nodes.responses import ResponseCollector, RunFailed, StageLiveness

RUN, OTHER = "run", "another run"
STAGES = ("predictor", "conflict", "policy", "ego", "recorder")
EGO_ID = 7
CONTROLS, CONTROL = "/litsim/controls", "/litsim/ego/control"
TWIST = "/litsim/ego/twist"


def controls(*ids: int, acceleration: float = -1.0) -> ControlTable:
    zeros = np.zeros(len(ids))
    return ControlTable(0, np.array(ids, np.int64), zeros + acceleration, zeros, zeros, np.zeros(len(ids), np.uint8))


class Bridge:
    """Answers with all that they need; the recorder keeps up unless a test says otherwise."""

    def __init__(self, agent_table: Any, *, with_policy: bool = True, stop: bool = True, recorded: int = 10**6) -> None:
        self.liveness = StageLiveness(RUN, STAGES)
        self.liveness.take_confirmation(RUN, recorded)
        self.port = EgoPort(RUN, VehicleModel(), Interface.CONTROL)
        self.read: list[ControlTable] = []
        self.responses = ResponseCollector(
            self.port,
            self.liveness,
            self._convert,
            run_id=RUN,
            ego_id=EGO_ID,
            with_policy=with_policy,
            stop_on_missing=stop,
        )
        self._agent_table = agent_table

    def _convert(self, message: ControlTable) -> ControlTable:
        self.read.append(message)
        return message

    def open(self, step: int) -> None:
        self.responses.open(self._agent_table(step, {"id": EGO_ID}), driven=True)

    def ego(self, step: int, acceleration: float = 0.5) -> None:
        self.port.ask()
        self.port.offer(Answer(Interface.CONTROL, EgoCommand(step, acceleration, 0.0), step=step, run_id=RUN))

    def settle(self) -> list[str]:
        return self.responses.settle(5.0, lambda: "; silent: policy")


@pytest.fixture
def bridge(agent_table: Any) -> Bridge:
    return Bridge(agent_table)


def test_a_stage_is_awaited_until_it_says_that_it_is_ready() -> None:
    liveness = StageLiveness(RUN, STAGES)
    assert liveness.awaited == ["conflict", "ego", "policy", "predictor"]
    for stage in STAGES[:4]:
        liveness.take_status(OTHER, stage, StageState.READY, "")
        liveness.take_status(RUN, stage, StageState.RUNNING, "")
    assert len(liveness.awaited) == 4
    for stage in STAGES[:4]:
        assert not liveness.all_ready
        liveness.take_status(RUN, stage, StageState.READY, "")
    assert liveness.awaited == ["recorder"]  # it waits to hear all others
    liveness.take_status(RUN, "recorder", StageState.READY, "")
    assert (liveness.all_ready, liveness.awaited) == (True, [])


def test_failures_are_quoted_with_the_names_of_the_stages() -> None:
    liveness = StageLiveness(RUN, STAGES)
    liveness.take_status(OTHER, "ego", StageState.FAILED, "no map")
    liveness.take_status(RUN, "bridge", StageState.FAILED, "what it said itself")
    liveness.check()
    liveness.take_status(RUN, "ego", StageState.FAILED, "no map")
    liveness.take_status(RUN, "policy", StageState.FAILED, "step 5: no weights")
    with pytest.raises(RunFailed, match=r"^ego: no map; policy: step 5: no weights$"):
        liveness.check()


def test_two_nodes_of_a_stage_are_no_run_where_their_parameters_differ() -> None:
    liveness = StageLiveness(RUN, STAGES)
    for text in ("speed: 1", "speed: 1"):  # twice the same, or one that has said it again
        liveness.take_status(RUN, "ego", StageState.READY, text)
    liveness.check()
    liveness.take_status(RUN, "ego", StageState.READY, "speed: 2")
    with pytest.raises(RunFailed, match="ego: two nodes with different parameters answer"):
        liveness.check()


def test_idle_nodes_of_stages_that_take_no_part_are_not_heard() -> None:
    liveness = StageLiveness(RUN, ("ego", "recorder"))
    liveness.take_status(RUN, "policy", StageState.FAILED, "policy: 'replay' is unknown")
    liveness.take_status(RUN, "conflict", StageState.READY, "")
    liveness.check()
    assert liveness.awaited == ["ego"]


@pytest.mark.parametrize("state", [StageState.FINISHED, StageState.FAILED])
def test_the_recorder_closes_its_file_for_better_or_worse(state: StageState) -> None:
    liveness = StageLiveness(RUN, STAGES)
    assert not liveness.recorder_closing  # nobody is there to be waited for
    liveness.take_status(RUN, "recorder", StageState.READY, "")
    liveness.take_status(RUN, "policy", state, "")
    assert liveness.recorder_closing
    liveness.take_status(RUN, "recorder", state, "")
    assert (liveness.recorder_closing, liveness.recorder_done) == (False, True)


def test_who_has_not_answered_a_step_is_silent() -> None:
    liveness = StageLiveness(RUN, STAGES)
    liveness.take_timing(OTHER, "ego", 4)
    liveness.take_timing(RUN, "bridge", 4)
    both = (CONTROLS, CONTROL)
    assert liveness.silent(4, (CONTROL,)) == ["ego"]
    assert liveness.silent(4, both) == ["predictor", "conflict", "policy", "ego"]  # which of them, cannot be told
    liveness.take_timing(RUN, "predictor", 4)
    liveness.take_timing(RUN, "ego", 4)
    liveness.take_timing(RUN, "ego", 3)
    liveness.take_timing(RUN, "conflict", 3)
    assert liveness.silent(4, both) == ["conflict"]  # the policy waits for it
    assert liveness.silent(5, both) == ["predictor", "ego"]
    assert liveness.silent(5, (CONTROLS,)) == ["predictor"]


def test_the_recorder_may_be_behind_by_its_window_but_not_at_step_0() -> None:
    liveness = StageLiveness(RUN, STAGES)
    nothing = r"^recorder: has confirmed nothing on /litsim/recorded at step 0, expected at most 50 steps behind$"
    with pytest.raises(RunFailed, match=nothing):
        liveness.check_recorder_keeps_up(0)
    liveness.take_confirmation(OTHER, 99)
    assert not liveness.recorder_keeps_up(0)
    liveness.take_confirmation(RUN, 5)
    liveness.take_confirmation(RUN, 0)  # an older one
    liveness.check_recorder_keeps_up(5 + RECORDER_WINDOW)
    with pytest.raises(RunFailed, match="has confirmed only step 5 on /litsim/recorded at step 56"):
        liveness.check_recorder_keeps_up(6 + RECORDER_WINDOW)


def test_the_last_step_is_to_be_confirmed() -> None:
    liveness = StageLiveness(RUN, STAGES)
    liveness.take_confirmation(RUN, 34)
    liveness.check_recorded(34)
    with pytest.raises(RunFailed, match=r"^recorder: has confirmed only step 34 of 35 on /litsim/recorded$"):
        liveness.check_recorded(35)


def test_a_step_is_complete_once_both_have_answered_it(bridge: Bridge) -> None:
    bridge.open(0)
    assert bridge.responses.missing == [CONTROLS, CONTROL]
    bridge.responses.offer_controls(RUN, 0, controls(1, 2))
    assert bridge.responses.missing == [CONTROL]
    bridge.ego(0)
    assert bridge.responses.complete
    assert bridge.settle() == []
    assert bridge.responses.command() == EgoCommand(0, 0.5, 0.0)
    assert bridge.responses.controls().id.tolist() == [1, 2]
    bridge.open(1)
    assert bridge.responses.missing == [CONTROLS, CONTROL]


def test_without_a_policy_the_ego_alone_answers(agent_table: Any) -> None:
    bridge = Bridge(agent_table, with_policy=False)
    bridge.open(3)
    assert bridge.responses.missing == [CONTROL]
    bridge.ego(3)
    assert bridge.responses.complete
    assert (bridge.responses.controls().step, len(bridge.responses.controls().id)) == (3, 0)


def test_an_external_ego_may_answer_on_several_topics_until_it_has_chosen(bridge: Bridge) -> None:
    bridge.port.interface = None
    bridge.open(0)
    assert bridge.responses.missing[1] == f"{CONTROL} or /litsim/ego/twist or /litsim/ego/trajectory"
    bridge.ego(0)
    assert bridge.responses.missing == [CONTROLS]


def test_a_recorder_that_falls_behind_is_waited_for_and_then_ends_the_run(agent_table: Any) -> None:
    bridge = Bridge(agent_table, with_policy=False, stop=False, recorded=0)
    bridge.open(RECORDER_WINDOW + 1)
    bridge.ego(RECORDER_WINDOW + 1)
    assert (bridge.responses.missing, bridge.responses.complete) == ([], False)
    with pytest.raises(RunFailed, match=r"^recorder: has confirmed only step 0 "):
        bridge.settle()


@pytest.mark.parametrize(("step", "stop"), [(4, True), (0, True), (0, False)])
def test_a_missing_answer_ends_the_run_and_says_who_is_silent(agent_table: Any, step: int, stop: bool) -> None:
    bridge = Bridge(agent_table, stop=stop)
    bridge.open(step)
    bridge.ego(step)
    with pytest.raises(RunFailed, match=f"^no answer to step {step} on {CONTROLS} within 5 s; silent: policy$"):
        bridge.settle()


def test_where_missing_answers_are_held_the_newest_counts_on_and_they_are_counted(agent_table: Any) -> None:
    bridge = Bridge(agent_table, stop=False)
    bridge.open(0)
    bridge.responses.offer_controls(RUN, 0, controls(1, acceleration=-2.0))
    bridge.ego(0, -3.0)
    assert bridge.settle() == []
    bridge.open(1)
    assert bridge.settle() == [CONTROLS, CONTROL]
    held = bridge.responses.controls()
    assert (held.step, held.acceleration.tolist()) == (1, [-2.0])
    assert bridge.responses.command() == EgoCommand(1, -3.0, 0.0)
    bridge.open(2)
    bridge.ego(2)
    bridge.responses.offer_controls(RUN, 1, controls(1, acceleration=-4.0))  # late: the newest from now on
    assert bridge.settle() == [CONTROLS]
    assert bridge.responses.controls().acceleration.tolist() == [-4.0]
    summary = bridge.responses.summary()
    assert summary["missed"] == {CONTROLS: 2, CONTROL: 1}
    assert summary["stale"] == {CONTROLS: 1}
    assert (summary["ego_port"]["interface"], summary["ego_port"]["answered"]) == ("control", 2)


def test_answers_of_other_runs_and_second_ones_are_stale(bridge: Bridge) -> None:
    bridge.open(0)
    bridge.responses.offer_controls(OTHER, 0, controls(1))
    assert CONTROLS in bridge.responses.missing
    bridge.responses.offer_controls(RUN, 0, controls(2))
    bridge.responses.offer_controls(RUN, 0, controls(3))
    assert bridge.responses.controls().id.tolist() == [2]
    assert bridge.responses.summary()["stale"] == {CONTROLS: 2}
    assert len(bridge.read) == 1  # only what counts is read


def test_the_command_of_a_step_is_taken_once(bridge: Bridge) -> None:
    bridge.open(0)
    assert not bridge.responses.commanded
    bridge.ego(0, 1.0)
    assert bridge.responses.command() is bridge.responses.command()
    assert bridge.responses.commanded
    bridge.open(1)
    assert not bridge.responses.commanded


def test_an_answer_of_the_ego_that_cannot_be_used_ends_the_run(bridge: Bridge) -> None:
    bridge.open(4)
    bridge.ego(4, float("nan"))
    with pytest.raises(RunFailed, match=f"^the answer to step 4 on {CONTROL} cannot be used: acceleration is nan"):
        bridge.responses.command()


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (replace(controls(1, 2), yaw_rate=np.zeros(1)), "yaw_rate has 1 values, expected 2, as many as id"),
        (controls(2, 1), "id 1 follows 2, expected ids that ascend"),
        (controls(1, 1), "id 1 follows 1, expected ids that ascend"),
        (controls(1, EGO_ID), "id lists the ego, 7, which has a port of its own"),
        (
            replace(controls(1, 2), acceleration=np.array([0.0, np.inf])),
            "acceleration of agent 2 is inf, expected a finite number",
        ),
    ],
)
def test_controls_that_the_world_does_not_expect_end_the_run(
    bridge: Bridge, wrong: ControlTable, expected: str
) -> None:
    bridge.open(2)
    bridge.responses.offer_controls(RUN, 2, wrong)
    with pytest.raises(RunFailed) as raised:
        bridge.responses.controls()
    assert str(raised.value) == f"the answer to step 2 on {CONTROLS} cannot be used: {expected}"


HERE = EgoPublisher(CONTROL, "/mine")
DEAF = EgoPublisher(CONTROL, "/mine", "is BEST_EFFORT and cannot be heard, expected RELIABLE")
ELSEWHERE = EgoPublisher(TWIST, "/mine")
RIVAL = EgoPublisher(CONTROL, "/other")
NAMELESS = EgoPublisher(CONTROL, "")
MUTE = f"/mine: it publishes on {CONTROL}, but no message has been received; until step 0 is answered"
STALE = f"/mine: it does not answer this step: {CONTROL}: the answer to step 3, at step 5, is stale"


@pytest.mark.parametrize(
    ("answered", "there", "known", "words"),
    [
        ((), (), (), f"no node publishes on {CONTROL}; is it running in here?"),
        ((), (DEAF,), (), f"/mine: its publisher on {CONTROL} is BEST_EFFORT and cannot be heard, expected RELIABLE"),
        ((), (HERE,), (), MUTE),
        ((), (ELSEWHERE,), (), f"/mine: it publishes on {TWIST}, expected {CONTROL}"),
        ((), (ELSEWHERE, HERE), (), MUTE),
        ((3, 4), (), ("/mine",), "/mine: it has answered until step 4; its publisher has left"),
        ((3, 4), (ELSEWHERE,), (), "/mine: it has answered until step 4; its publisher has left"),
        ((3, 4), (HERE,), (), "/mine: it has answered until step 4; its publisher is still announced, so it hangs, or"),
        (
            (3, 4),
            (DEAF,),
            (),
            "/mine: it has answered until step 4; its publisher is BEST_EFFORT and cannot be heard, expected RELIABLE",
        ),
        ((3, 4), (DEAF, HERE), (), "/mine: it has answered until step 4; its publisher is still announced"),
        ((3, 4), (NAMELESS,), ("/mine",), "/mine: it has answered until step 4; its publisher is still announced"),
        ((3, 4), (NAMELESS,), (), "it has answered until step 4; its publisher is still announced"),
        ((3, 4, 5, 3), (HERE,), (), STALE),
    ],
)
def test_an_ego_that_does_not_answer_is_described(
    bridge: Bridge, answered: tuple[int, ...], there: tuple[EgoPublisher, ...], known: tuple[str, ...], words: str
) -> None:
    for step in (3, 4):
        bridge.open(step)
        if step in answered:
            bridge.ego(step)
    bridge.open(5)
    for step in answered[3:]:
        bridge.ego(step)
    assert absence(bridge.port, there, known, "here").startswith(words)


@pytest.mark.parametrize(
    ("answered", "there", "said"),
    [
        (
            (3, 3),
            (HERE, RIVAL),
            f"2 publishers are on {CONTROL} (/mine, /other), and 1 messages there were not asked for",
        ),
        ((3, 2, 9), (HERE, NAMELESS), f"2 publishers are on {CONTROL} (/mine, ?), and 2 messages there were not asked"),
        ((3, 3), (HERE, HERE), f"2 publishers are on {CONTROL} (/mine, /mine), and 1 messages"),
        ((3,), (HERE, RIVAL), ""),
        ((3, 3), (HERE,), ""),
        ((3, 3), (HERE, DEAF), ""),
        ((3, 3), (HERE, ELSEWHERE), ""),
    ],
)
def test_several_stacks_that_answer_are_told(
    bridge: Bridge, answered: tuple[int, ...], there: tuple[EgoPublisher, ...], said: str
) -> None:
    bridge.open(3)
    bridge.port.ask()
    for step in answered:
        bridge.port.offer(Answer(Interface.CONTROL, EgoCommand(step, 0.5, 0.0), step=step, run_id=RUN))
    found = rivalry(bridge.port, there)
    assert found.startswith(said) and bool(found) == bool(said)


def on_twist(node: str, process: bytes, unheard: str = "") -> EgoPublisher:
    return EgoPublisher(TWIST, node, unheard, process * 12 + b"xxxx")


@pytest.mark.parametrize(
    ("interface", "second", "said"),
    [
        ("auto", on_twist("/other", b"2"), f"several nodes answer: /mine on {CONTROL}, /other on {TWIST}; it would"),
        ("auto", on_twist("", b"2"), f"several nodes answer: /mine on {CONTROL}, ? on {TWIST}; it would depend"),
        ("auto", on_twist("/other", b"1"), ""),  # of one process
        ("auto", on_twist("/mine", b"2"), ""),
        ("auto", on_twist("/other", b"2", "has type geometry_msgs/msg/Twist"), ""),
        ("control", on_twist("/other", b"2"), ""),
    ],
)
def test_stacks_that_answer_on_several_inputs_are_told_unless_one_was_chosen(
    interface: str, second: EgoPublisher, said: str
) -> None:
    port = EgoPort(RUN, VehicleModel(), interface)
    port.open(3, None, driven=False)
    port.ask()
    there = (EgoPublisher(CONTROL, "/mine", gid=b"1" * 12 + b"yyyy"), second)
    port.offer(Answer(Interface.CONTROL, EgoCommand(3, 0.5, 0.0), step=3, run_id=RUN))
    assert rivalry(port, there) == ""
    port.offer(Answer(Interface.TWIST, TwistTarget(3.0, 0.0), 3 * STEP_NS))
    assert port.counts["refused"] == 1
    found = rivalry(port, there)
    assert found.startswith(said) and bool(found) == bool(said)


FIRST, AGAIN = (EgoPublisher(CONTROL, node, gid=gid) for node, gid in (("/mine", b"1"), ("", b"2")))


@pytest.mark.parametrize(
    ("looks", "joined"),
    [
        (((FIRST,), (FIRST,), ()), 0),
        (((), (FIRST,), (FIRST,)), 0),
        (((FIRST, AGAIN), (AGAIN,)), 0),
        (((FIRST,), (AGAIN,)), 1),
        (((FIRST,), (), (FIRST, AGAIN), (AGAIN,)), 1),
        (((FIRST,), (AGAIN,), (FIRST,)), 1),
        (((FIRST,), (FIRST, EgoPublisher(TWIST, "/mine", gid=b"3"))), 0),
        (((FIRST,), (FIRST, EgoPublisher(CONTROL, "/deaf", "is BEST_EFFORT", b"3"))), 0),
    ],
)
def test_a_stack_that_is_started_again_is_told_once(
    bridge: Bridge, looks: tuple[tuple[EgoPublisher, ...], ...], joined: int
) -> None:
    bridge.open(0)
    bridge.ego(0)
    met = EgoPublishers()
    told = [text for there in looks for text in met.note(bridge.port, there, ["/mine"])]
    assert met.any_known
    said = (
        f"/mine: its publisher on {CONTROL} was not there at step 0; a stack that has been started again in mid-run "
        "answers without what it knew before"
    )
    assert told == [said] * joined
    assert bridge.responses.summary()["ego_port"]["joined"] == joined


def test_the_answer_to_a_step_that_was_published_again_is_never_stale(bridge: Bridge) -> None:
    bridge.open(0)
    bridge.responses.ask()
    bridge.responses.ask()
    bridge.port.offer(Answer(Interface.CONTROL, EgoCommand(0, 0.5, 0.0), step=0, run_id=RUN))
    bridge.responses.offer_controls(RUN, 0, controls())
    bridge.open(1)
    bridge.responses.ask()
    for count in (0, 1):  # the second answer was asked for, a third is too much
        bridge.port.offer(Answer(Interface.CONTROL, EgoCommand(0, 0.5, 0.0), step=0, run_id=RUN))
        bridge.responses.offer_controls(RUN, 0, controls())
        assert bridge.port.counts["stale"] == count
        assert bridge.responses.summary()["stale"].get(CONTROLS, 0) == count
    assert bridge.responses.missing == [CONTROLS, CONTROL]
