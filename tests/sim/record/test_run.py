"""A run survives its bag: arrays, answers, attachments; and what is missing is found."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from litsim_eval.analysis.measures.identity import digest
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import ARRAY_FIELDS, Controller, ControlTable, EgoCommand, EgoMode
from litsim_sim.core.takeover import Takeover, TakeoverReason, TakeoverState
from litsim_sim.record.bag import BagReader, BagTopic, BagWriter, qos_yaml
from litsim_sim.record.run import TopicGaps, read_run

Make = Callable[..., Any]
STEPS = 24


@pytest.fixture
def run(table: Make, make_run: Make, moved: Make) -> Any:
    log = [table(k, *({"id": a, "x": k + 0.1 * a, "y": 5.0 * a} for a in (1, 2, 9))) for k in range(STEPS + 1)]
    record = Takeover(
        agent=2,
        opponent=1,
        state=TakeoverState.HELD,
        reason=TakeoverReason.BLOCKED_ENTRY,
        detected_step=4,
        time_to_conflict=1.25,
        overlap_probability=0.75,
        conflict_pose=(1.0, 2.0, 3.0),
        goal_pose=(4.0, 5.0, 6.0),
        reference_path=np.arange(6.0).reshape(3, 2),
        log_collision_predicted=True,
        residual_position=0.5,
        residual_speed=0.25,
    )
    ids, one = np.array([2, 9]), np.array([1, 3], np.uint8)
    return make_run(
        moved(log, 2, x=1.0 / 3.0, controller=Controller.POLICY),
        log,
        history_steps=10,
        takeovers={k: [record] if k == 4 else [] for k in range(STEPS + 1)},
        controls={k: ControlTable(k, ids, ids * 0.1, ids * 0.2, ids * 0.3, one) for k in range(STEPS + 1)},
        ego_commands={k: EgoCommand(k, 0.1 * k, -0.1, EgoMode.FOLLOW_LOG) for k in range(STEPS + 1)},
        timing={"policy": {k: 0.001 * k for k in range(STEPS + 1)}},
        net_xml=b"<net/>",
    )


def test_round_trip(run: Any, write_run: Make, tmp_path: Path) -> None:
    back = read_run(write_run(run, tmp_path / "bag"))
    assert back.path == tmp_path / "bag/run_0.mcap"
    assert back.info == run.info
    assert back.complete
    for given, found in ((run.tables, back.tables), (run.log, back.log)):
        for a, b in zip(given, found, strict=True):
            assert a.step == b.step
            assert all(np.array_equal(getattr(a, f), getattr(b, f)) for f in ARRAY_FIELDS)
            assert all(getattr(a, f).dtype == getattr(b, f).dtype for f in ARRAY_FIELDS)
    assert back.ego_commands == run.ego_commands
    assert {k: v.acceleration.tolist() for k, v in back.controls.items()} == {
        k: v.acceleration.tolist() for k, v in run.controls.items()
    }
    assert back.timing == run.timing
    assert back.statuses == run.statuses
    assert back.summary["wall_s"] == 2.0
    assert back.net_xml == b"<net/>"
    assert yaml.safe_load(back.scenario_yaml)["start_frame"] == 100
    assert not any(back.gaps.values())
    assert digest(back) == digest(run)


def test_runs_of_one_log_share_it_in_memory(run: Any, write_run: Make, make_run: Make, tmp_path: Path) -> None:
    first, second = (read_run(write_run(run, tmp_path / name)) for name in ("first", "second"))
    assert first.logged is second.logged
    shorter = make_run(run.tables[:-1], run.log[:-1], history_steps=10)
    assert len(read_run(write_run(shorter, tmp_path / "shorter")).logged) == len(first.logged) - 1


def test_what_a_stack_tells_of_its_minimum_risk_manoeuvre(run: Any, write_run: Make, tmp_path: Path) -> None:
    bag = write_run(run, tmp_path / "bag")
    whole = BagReader(bag)
    with BagWriter(tmp_path / "more", "more") as writer:
        for topic in whole.topics.values():
            writer.add_topic(topic)
        kind = "autoware_adapi_v1_msgs/msg/MrmState"
        writer.add_topic(BagTopic("/mrm", kind, "uint16 state\nuint16 behavior\n", qos_yaml(1), ""))
        for message in whole.messages():
            writer.write(message.topic, message.data, message.log_time_ns)
        for step, state in ((3, 1), (7, 2)):
            writer.write("/mrm", b"\x00\x01\x00\x00" + bytes([state, 0, 1, 0]), step * 100_000_000)
    assert read_run(tmp_path / "more").minimum_risk == {3: 1, 7: 2}
    assert read_run(bag).minimum_risk == {}


def test_takeovers_survive(run: Any, write_run: Make, tmp_path: Path) -> None:
    back = read_run(write_run(run, tmp_path / "bag"))
    assert {k for k, records in back.takeovers.items() if records} == {4}
    (given,), (found,) = run.takeovers[4], back.takeovers[4]
    assert np.array_equal(found.reference_path, given.reference_path)
    rest = [name for name in vars(given) if name != "reference_path"]
    assert [getattr(found, n) for n in rest] == [getattr(given, n) for n in rest]


def test_takeovers_of_older_records_lack_what_is_new(run: Any) -> None:
    (given,) = run.takeovers[4]
    old = {name: value for name, value in vars(given).items() if name not in ("path_source", "time_shift")}
    old |= {name: SimpleNamespace(x=1.0, y=2.0, theta=0.5) for name in ("conflict_pose", "goal_pose")}
    found = Takeover.of_message(SimpleNamespace(**old))
    assert (found.path_source, found.time_shift, found.agent) == (0, 0.0, given.agent)
    del old["agent"]
    with pytest.raises(AttributeError, match="agent"):
        Takeover.of_message(SimpleNamespace(**old))


def test_a_run_without_a_policy_has_none_of_somebody_else(run: Any, write_run: Make, tmp_path: Path) -> None:
    topics = ("/clock", "/litsim/agents", "/litsim/ego/control")
    alone = replace(run, info=replace(run.info, policy="replay", topics=topics))
    back = read_run(write_run(alone, tmp_path / "bag"))
    assert run.controls and run.takeovers
    assert (back.controls, back.takeovers) == ({}, {})


def test_gaps_are_found(run: Any, write_run: Make, tmp_path: Path) -> None:
    skip = [("/litsim/agents", 7), ("/litsim/controls", 3), ("/litsim/controls", 24), ("/clock", 0)]
    back = read_run(write_run(run, tmp_path / "bag", skip=skip, twice=[("/litsim/ego/control", 5)]))
    assert back.gaps["/litsim/agents"] == TopicGaps(missing=(7,))
    assert back.gaps["/litsim/controls"] == TopicGaps(missing=(3, 24))
    assert back.gaps["/clock"] == TopicGaps(missing=(0,))
    assert back.gaps["/litsim/ego/control"] == TopicGaps(duplicated=(5,))
    assert [t.step for t in back.tables] == [k for k in range(STEPS + 1) if k != 7]
    assert [t.step for t in back.log] == [t.step for t in back.tables]


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([0, 1, 2], TopicGaps()),
        ([0, 2], TopicGaps(missing=(1,))),
        ([0, 1, 1, 2], TopicGaps(duplicated=(1,))),
        ([1, 0, 2], TopicGaps(unordered=(0,))),
        ([], TopicGaps(missing=(0, 1, 2))),
    ],
)
def test_kinds_of_gaps(steps: list[int], expected: TopicGaps) -> None:
    assert TopicGaps.find(steps, 2) == expected
    assert bool(expected) == (steps != [0, 1, 2])


def test_other_bags_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", "run") as writer:
        writer.add_topic(BagTopic("/text", "std_msgs/msg/String", "string data\n", qos_yaml(1), ""))
        writer.write("/text", bytes([0, 1, 0, 0, 2, 0, 0, 0, 65, 0]), 0)
    with pytest.raises(InputError, match="no LitSim run: no message on /litsim/run_info"):
        read_run(tmp_path / "bag")


def test_messages_of_another_version_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", "run") as writer:
        writer.add_topic(BagTopic("/litsim/run_info", "litsim_msgs/msg/RunInfo", "string name\n", qos_yaml(1), ""))
        writer.write("/litsim/run_info", bytes([0, 1, 0, 0, 2, 0, 0, 0, 65, 0]), 0)
    with pytest.raises(InputError, match=r"topic /litsim/run_info at 0.0 s: cannot be read as the litsim_msgs"):
        read_run(tmp_path / "bag")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda run: replace(run, info=replace(run.info, total_steps=2**32 - 1)),
            "steps of the run: 4294967295, expected at most 864000",
        ),
        (
            lambda run: replace(run, timing={}, tables=[replace(run.tables[0], step=2**32 - 1)]),
            "step: 4294967295, expected at most 24",
        ),
    ],
)
def test_steps_beyond_the_budget_are_refused(
    run: Any, write_run: Make, tmp_path: Path, change: Callable[[Any], Any], said: str
) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        read_run(write_run(change(run), tmp_path / "bag"))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("name: demo\n", "no whole number in field 'start_frame'"),
        ("just words", "no whole number in field 'start_frame'"),
        ("start_frame: [0\n", r"run_0\.mcap: scenario of the run: malformed YAML: .* line 2"),
    ],
)
def test_scenario_without_start_frame_is_refused(
    text: str, why: str, table: Make, make_run: Make, write_run: Make, tmp_path: Path
) -> None:
    run = make_run([table(0, {"id": 1, "x": 0.0, "y": 0.0})], scenario_yaml=text)
    with pytest.raises(InputError, match=why):
        read_run(write_run(run, tmp_path / "bag"))
