"""A record as it is needed to run it again: scenario, messages by step, parameters; and what is noted or refused."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from litsim_msgs.msg import RunInfo, StageStatus
from rclpy.serialization import serialize_message

from litsim_eval.runs.recorded_run import open_record
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_NS, EgoCommand
from litsim_sim.record.bag import BagReader, BagWriter
from litsim_sim.ros import messages, topics
from litsim_sim.scenario.run_info import RunPlan, versions
from litsim_sim.scenario.scenario import Scenario, packaged

STEPS = 5
Said = tuple[topics.Topic, int, Any]


@pytest.fixture(scope="module")
def scenario(make_scenario: Any, track: Any, lane_centres: Any) -> Scenario:
    made: Scenario = make_scenario(track(1, 100.0, lane_centres[1], last=STEPS + 10))
    return made


@pytest.fixture
def write(scenario: Scenario, tmp_path: Path) -> Callable[..., Path]:
    """Writes a bag with a run's information, the files of its scenario, its step 0, and what else is given."""

    made = scenario

    def bag(
        *said: Said, without: str = "", hashes: str = "", fields: Any = None, scenario: Scenario = made, **info: Any
    ) -> Path:
        plan = RunPlan(scenario, "external", "replay")
        facts = plan.facts() | {"versions": yaml.safe_dump(versions()), "configuration": "{}"} | info
        resolved = yaml.safe_load(scenario.to_yaml()) | {"recording": "/gone", "net": "/gone"} | (fields or {})
        attached = {
            "scenario.yaml": yaml.safe_dump(resolved).encode(),
            "net.xml": scenario.net_path.read_bytes(),
            "recording.parquet": scenario.recording.parquet,
        }
        with BagWriter(tmp_path / "bag", "bag") as writer:
            for topic in topics.RECORDED_TOPICS:
                described = topic.described
                writer.add_topic(replace(described, type_hash=hashes or described.type_hash))
            for name, data in attached.items():
                if name != without:
                    writer.attach(name, "", data)
            if without != "run_info":
                run_info = RunInfo(header=messages.header(0), **facts)
                writer.write(topics.RUN_INFO.name, serialize_message(run_info), 0)
            agents = messages.agents_to_message(scenario.log.table(0), plan.run_id, plan.scenario.total_steps, 1)
            writer.write(topics.AGENTS.name, serialize_message(agents), 0)
            for topic, step, message in said:
                writer.write(topic.name, serialize_message(message), step * STEP_NS)
        return tmp_path / "bag"

    return bag


@pytest.fixture
def run_id(scenario: Scenario) -> str:
    return RunPlan(scenario, "external", "replay").run_id


def ego(step: int, acceleration: float, run_id: str, topic: topics.Topic = topics.EGO_CONTROL) -> Said:
    return topic, step, messages.ego_to_message(EgoCommand(step, acceleration, 0.0), run_id)


def ready(stage: str, text: str, run_id: str) -> Said:
    return topics.STATUS, 0, messages.status(run_id, stage, StageStatus.READY, text=text)


def test_the_scenario_comes_from_the_attachments_while_the_record_is_open(write: Any, scenario: Scenario) -> None:
    with open_record(write(fields={"crop": {"v": [0, 1]}})) as record:  # the recording is cropped already
        assert record.scenario.recording.parquet == scenario.recording.parquet
        assert record.scenario.net_path.read_bytes() == scenario.net_path.read_bytes()
        assert (record.scenario.ego_id, record.run.info.ego) == (1, "external")
        folder = record.scenario.net_path.parent
        assert folder.is_dir()
    assert not folder.exists()


def test_signals_that_the_recording_carries_are_those_of_the_run(write: Any) -> None:
    street = Scenario.load(packaged("suites/small/street_14.yaml", "litsim_eval"))
    assert street.signals is not None and street.file.signals is None
    with open_record(write(scenario=street, fields={"net": str(street.net_path)})) as record:
        assert record.scenario.signals is not None
        assert (record.scenario.signals.states == street.signals.states).all()


def test_of_a_step_that_comes_twice_the_first_counts_and_other_runs_do_not(write: Any, run_id: str) -> None:
    said = [ego(0, -1.0, "another"), ego(0, 1.0, run_id), ego(0, 2.0, run_id), ego(3, 3.0, run_id)]
    with open_record(write(*said)) as record:
        found = record.messages[topics.EGO_CONTROL.name]
        assert {step: message.acceleration for step, message in found.items()} == {0: 1.0, 3: 3.0}
        assert record.messages[topics.CONTROLS.name] == {}


def test_of_an_external_ego_counts_what_the_bridge_made_of_its_answers(write: Any, run_id: str) -> None:
    said = [ego(0, 1.0, run_id), ego(0, 5.0, run_id, topics.EGO_APPLIED)]
    with open_record(write(*said, topics=[topics.EGO_APPLIED.name])) as record:
        assert record.messages[topics.EGO_CONTROL.name][0].acceleration == 5.0
        assert topics.EGO_APPLIED.name not in record.messages


def test_parameters_are_those_of_the_configuration_and_of_the_stages(write: Any, run_id: str) -> None:
    said = [
        ready("conflict", "{roi: 20.0, detection: {margin: 0.5}}", run_id),
        ready("policy", "policy: {name: yield}", run_id),
        ready("ego", "no: [yaml", run_id),
    ]
    with open_record(write(*said, configuration="{bridge: {mode: lockstep}, odd: 3}")) as record:
        assert record.parameters == {
            "bridge": {"mode": "lockstep"},
            "conflict": {"roi": 20.0, "detection.margin": 0.5},
            "policy": {"name": "yield"},
        }


def test_what_keeps_a_second_run_from_coming_out_equal_is_noted(write: Any, scenario: Scenario) -> None:
    total = scenario.total_steps
    with open_record(write(versions="{commit: abc}", total_steps=total + 2)) as record:
        assert record.notes == [
            f"{total + 2} steps were run, {total} are attached",
            f"recorded with commit abc, this is {versions()['commit']}",
            f"the record ends at step 0 of {total + 2}",
            "1 steps lack the ego's answer, the first is 0",
        ]


def test_a_record_that_is_cut_short_is_read_as_far_as_it_goes(write: Any, run_id: str) -> None:
    bag = write(ego(0, 1.0, run_id))
    path = bag / "bag_0.mcap"
    path.write_bytes(path.read_bytes()[:-30])
    with open_record(bag) as record:
        assert record.notes[0].startswith("the recording is not complete (cut short at byte ")
        assert record.messages[topics.EGO_CONTROL.name].keys() == {0}


def test_a_message_that_cannot_be_read_is_named(write: Any, run_id: str) -> None:
    path = write(ego(0, 1.0, run_id)) / "bag_0.mcap"
    reader = BagReader(path)
    said = list(reader.messages())
    with BagWriter(path.parent, "bag", overwrite=True) as writer:
        for topic in reader.topics.values():
            writer.add_topic(topic)
        for message in said:
            data = message.data[:9] if message.topic == topics.EGO_CONTROL.name else message.data
            writer.write(message.topic, data, message.log_time_ns)
    with (
        pytest.raises(InputError, match=r"/litsim/ego/control at 0\.0 s: cannot be read as the litsim_msgs/msg/Ego"),
        open_record(path),
    ):
        pass


@pytest.mark.parametrize(
    ("lacking", "said"),
    [
        *(
            ({"without": name}, f"cannot be repeated without attachment {name}$")
            for name in ("scenario.yaml", "net.xml", "recording.parquet")
        ),
        ({"without": "run_info"}, "no LitSim run: no message on /litsim/run_info$"),
        ({"hashes": "RIHS01_0"}, "/litsim/run_info was recorded with another version of litsim_msgs/msg/RunInfo$"),
    ],
)
def test_a_bag_that_lacks_something_is_refused(write: Any, lacking: dict[str, str], said: str) -> None:
    with pytest.raises(InputError, match=said), open_record(write(**lacking)):
        pass
