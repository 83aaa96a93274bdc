"""Stages and runs once more from their record: equal, and where the record was tampered with, found there."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from litsim_msgs.msg import Controls, RunInfo, StageStatus, Takeover, Takeovers
from rclpy.serialization import serialize_message

from command_line import status
from litsim_eval.cli import rerun as command
from litsim_eval.runs.message_diff import differences
from litsim_eval.runs.recorded_run import open_record
from litsim_eval.runs.rerun import rerun_stage, resimulate
from litsim_policy.conflict.messages import takeovers_to_message
from litsim_predictor.models import DEFAULT_MODEL, PredictorConfig, make_predictor
from litsim_predictor.ros.messages import forecast_to_message
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_NS
from litsim_sim.record.bag import BagWriter
from litsim_sim.record.seal import RunFacts, write_seal
from litsim_sim.ros import messages, topics
from litsim_sim.ros.cdr import without_padding
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation

STEPS = 41
Tamper = Callable[[str, int, Any], Any]
"""What is to be recorded instead of a message of a topic and step; None leaves it out."""


@pytest.fixture(scope="module")
def answered(make_scenario: Any, track: Any, lane_centres: Any) -> tuple[Scenario, RunInfo, list[tuple[str, int, Any]]]:
    """A run in process as the messages that its graph would have published: the ego slows down before 14."""
    places = {13: (100.0, 1), 14: (85.0, 1), 15: (100.0, 2), 16: (80.0, 2), 17: (95.0, 0), 18: (90.0, 3)}
    tracks = [track(i, x, lane_centres[lane], 15.0, last=STEPS - 1) for i, (x, lane) in places.items()]
    scenario = make_scenario(*tracks)
    plan = RunPlan(scenario, "idm", "litsim")
    info = RunInfo(header=messages.header(0), topics=[topics.CONTROLS.name], **plan.facts())
    predictor = make_predictor(DEFAULT_MODEL, scenario, modes=PredictorConfig().modes)
    found: list[tuple[str, int, Any]] = []
    for now in Simulation.of(plan).steps():
        step, run_id = now.table.step, plan.run_id
        found += [
            (topics.AGENTS.name, step, messages.agents_to_message(now.table, run_id, scenario.total_steps, 13)),
            (topics.FORECASTS.name, step, forecast_to_message(predictor.forecast(now.table), run_id)),
            (topics.TAKEOVERS.name, step, takeovers_to_message(now.takeovers, run_id)),
            (topics.CONTROLS.name, step, messages.controls_to_message(now.controls, run_id)),
            (topics.EGO_CONTROL.name, step, messages.ego_to_message(now.ego, run_id)),
        ]
    return scenario, info, found


@pytest.fixture
def write(answered: Any, tmp_path: Path) -> Callable[..., Path]:
    """Writes the run to a bag, tampered with."""

    def bag(tamper: Tamper = lambda topic, step, message: message, **ready: str) -> Path:
        scenario, info, found = answered
        with BagWriter(tmp_path / "bag", "bag") as writer:
            for topic in topics.RECORDED_TOPICS:
                writer.add_topic(topic.described)
            gone = {"recording": "/gone", "net": "/gone", "crop": {"v": [0, 1]}}
            fields = yaml.safe_load(scenario.to_yaml()) | gone
            writer.attach("scenario.yaml", "", yaml.safe_dump(fields).encode())
            writer.attach("net.xml", "", scenario.net_path.read_bytes())
            writer.attach("recording.parquet", "", scenario.recording.parquet)
            writer.write(topics.RUN_INFO.name, serialized(tamper(topics.RUN_INFO.name, 0, info)), 0)
            for stage, text in ready.items():
                status = messages.status(info.run_id, stage, StageStatus.READY, text=text)
                writer.write(topics.STATUS.name, serialized(status), 0)
            for topic, step, message in found:
                if (changed := tamper(topic, step, message)) is not None:
                    writer.write(topic, serialized(changed), step * STEP_NS)
        return tmp_path / "bag"

    return bag


def serialized(message: Any) -> bytes:
    """As the recorder writes it."""
    return without_padding(type(message))(serialize_message(message))


def copied(message: Any, **changes: Any) -> Any:
    values = {name: getattr(message, name) for name in message.get_fields_and_field_types()}
    return type(message)(**(values | changes))


def at(topic: topics.Topic, step: int, change: Callable[[Any], Any]) -> Tamper:
    return lambda name, k, message: change(message) if (name, k) == (topic.name, step) else message


def test_a_record_that_is_not_as_sealed_is_not_repeated(write: Any) -> None:
    bag = write()
    write_seal(bag, RunFacts("run-1", STEPS, "00ff", 3.0, ""))
    said = rf"run_id is .*; step is {STEPS - 1}, sealed is {STEPS}; digest is "
    with pytest.raises(InputError, match=said), open_record(bag):
        pass


def test_every_stage_answers_as_recorded(write: Any) -> None:
    with open_record(write()) as record:
        for stage in ("predictor", "conflict", "policy", "ego"):
            tally = rerun_stage(record, stage)
            assert (tally.compared, tally.different, tally.first) == (STEPS, 0, None), (stage, tally.first)
    assert sum("the defaults are used" in note for note in record.notes) == 4


def test_a_changed_forecast_is_found_at_its_step_and_agent(write: Any) -> None:
    def shift(message: Any) -> Any:
        mean = message.mean[:]
        width = len(mean) // len(message.id)
        mean[width + 3] += 0.25
        return copied(message, mean=mean)

    with open_record(write(at(topics.FORECASTS, 7, shift))) as record:
        tally = rerun_stage(record, "predictor")
        agent = record.messages[topics.FORECASTS.name][7].id[1]
    assert (tally.compared, tally.different) == (STEPS, 1)
    assert (tally.first.step, tally.first.field, tally.first.agent) == (7, "mean[3]", agent)
    assert tally.first.amount == pytest.approx(0.25)
    assert tally.largest == {"/litsim/forecasts mean": pytest.approx(0.25)}


def test_a_takeover_that_is_not_in_the_record_is_named(write: Any, answered: Any) -> None:
    step, agent = next(
        (k, m.takeovers[0].agent) for t, k, m in answered[2] if t == topics.TAKEOVERS.name and m.takeovers
    )
    with open_record(write(at(topics.TAKEOVERS, step, lambda m: copied(m, takeovers=[])))) as record:
        first = rerun_stage(record, "conflict").first
    assert (first.step, first.agent, first.field) == (step, agent, "takeovers")
    assert (first.recorded, first.computed) == ("absent", "present")


def test_the_first_difference_of_a_whole_run_is_where_it_was_made(write: Any) -> None:
    def nudge(message: Any) -> Any:
        x = message.x[:]
        x[4] += 1e-9
        return copied(message, x=x)

    with open_record(write(at(topics.AGENTS, 9, nudge))) as record:
        result = resimulate(record)
        agent = record.messages[topics.AGENTS.name][9].id[4]
    assert result.recorded != result.computed
    assert (result.tally.first.topic, result.tally.first.step) == ("/litsim/agents", 9)
    assert (result.tally.first.agent, result.tally.first.field) == (agent, "x")


def test_an_external_ego_answers_as_recorded(write: Any) -> None:
    bag = write(lambda topic, step, m: copied(m, ego="external") if topic == topics.RUN_INFO.name else m)
    with open_record(bag) as record:
        result = resimulate(record)
        with pytest.raises(InputError, match="the ego is external"):
            rerun_stage(record, "ego")
    assert result.recorded == result.computed


def test_recorded_parameters_are_taken(write: Any) -> None:
    told = {"predictor": "{model: kinematic, kinematic.horizon: 4.0}", "conflict": "conflict: {confirm_steps: 1}"}
    with open_record(write(**told)) as record:
        assert record.parameters["conflict"] == {"confirm_steps": 1}
        assert rerun_stage(record, "predictor").first.field == "horizon"
    assert not any("predictor" in note for note in record.notes)


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("{confirm_stepz: 1}", r"conflict: unknown parameter confirm_stepz \(near: confirm_steps"),
        ("{confirm_steps: -1}", "conflict: parameter confirm_steps is -1"),
    ],
)
def test_recorded_parameters_are_checked_as_those_of_a_run(write: Any, told: str, said: str) -> None:
    with open_record(write(conflict=told)) as record, pytest.raises(InputError, match=said):
        rerun_stage(record, "conflict")


def test_a_record_with_gaps_is_compared_as_far_as_it_goes(write: Any) -> None:
    bag = write(lambda topic, step, m: None if step > 15 or (topic, step) == (topics.EGO_CONTROL.name, 3) else m)
    with open_record(bag) as record:
        assert rerun_stage(record, "conflict").compared == 16
        assert rerun_stage(record, "ego").compared == 15
    assert any("ends at step 15 of 40" in note for note in record.notes)
    assert any("1 steps lack the ego's answer" in note for note in record.notes)


def test_a_record_that_ends_amid_a_step_is_equal_up_to_there(write: Any) -> None:
    answers = {topics.TAKEOVERS.name: 20, topics.CONTROLS.name: 19, topics.EGO_CONTROL.name: 20}
    ends: Tamper = lambda name, k, message: None if k > answers.get(name, 20) else message  # noqa: E731
    with open_record(write(ends)) as record:
        found = resimulate(record)
    assert found.steps == 20
    assert found.recorded == found.computed
    assert found.tally.different == 0


def test_a_record_without_a_complete_step_is_refused(write: Any) -> None:
    """As of a run whose ego never answered: step 0 alone differed, since the record lacks its command."""
    bag = write(lambda name, k, message: None if name == topics.EGO_CONTROL.name else message)
    with open_record(bag) as record, pytest.raises(InputError, match="has no complete step"):
        resimulate(record)


def test_exit_status_and_words(write: Any, answered: Any, tmp_path: Path, capsys: Any) -> None:
    def main(*words: object) -> tuple[int, str]:
        code, said = status(command.main, *words), capsys.readouterr()
        return code, said.out + said.err

    step = next(k for t, k, m in answered[2] if t == topics.CONTROLS.name and m.id)
    bag = write(at(topics.CONTROLS, step, lambda m: Controls(header=m.header, run_id=m.run_id, step=m.step)))
    assert main(bag, "--node", "predictor")[0] == 0
    code, said = main(bag, "--node", "policy", "--json", tmp_path / "found.json")
    assert code == 1 and "DIFFERENT, 1 of them" in said and f"first: step {step}, /litsim/controls, agent" in said
    found = json.loads((tmp_path / "found.json").read_text())
    assert (found["equal"], found["compared"], found["different"], found["first"]["step"]) == (False, STEPS, 1, step)
    code, said = main(bag, "--resimulate")
    assert code == 1 and "DIFFERENT" in said and f"first: step {step}" in said
    assert main(bag, "--node", "conflikt")[0] == 2
    assert main(tmp_path / "none", "--resimulate") == (2, f"error: {tmp_path / 'none'}: no such bag\n")


# Messages


def controls(ids: list[int], acceleration: list[float]) -> Controls:
    zeros = [0.0] * len(ids)
    return Controls(
        id=ids, acceleration=acceleration, lateral_acceleration=zeros, yaw_rate=zeros, source=bytes(len(ids))
    )


def test_first_and_largest_difference_of_an_array() -> None:
    found = differences("/t", 3, controls([1, 2, 3], [0.0, 1.0, 2.0]), controls([1, 2, 3], [0.0, 1.5, 5.0]))
    assert [(d.agent, d.amount) for d in found] == [(2, 0.5), (3, 3.0)]
    assert str(found[0]) == "step 3, /t, agent 2, field acceleration: recorded 1.0, now 1.5, off by 0.5"


def test_floats_are_compared_by_their_bits() -> None:
    nan = float("nan")
    assert not differences("/t", 0, controls([1], [nan]), controls([1], [nan]))
    assert differences("/t", 0, controls([1], [0.0]), controls([1], [-0.0]))


def test_agents_in_one_message_only() -> None:
    found = differences("/t", 0, controls([1, 2], [0.0, 0.0]), controls([2, 5], [0.0, 0.0]))
    assert [(d.agent, d.recorded, d.computed) for d in found] == [(1, "present", "absent"), (5, "absent", "present")]


def test_fields_of_records_are_matched_by_agent() -> None:
    a, b = (Takeovers(takeovers=[Takeover(agent=4), Takeover(agent=9)]) for _ in range(2))
    assert not differences("/t", 0, a, b)
    b.takeovers[1].goal_pose.x = 2.0
    (found,) = differences("/t", 0, a, b)
    assert (found.field, found.agent, found.amount) == ("takeovers.goal_pose.x", 9, 2.0)
