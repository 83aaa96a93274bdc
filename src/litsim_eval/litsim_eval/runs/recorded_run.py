"""A recorded run with the messages, scenario and parameters needed to repeat it, or one of its stages."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from litsim_msgs.msg import StageStatus
from rclpy.serialization import deserialize_message

from litsim_eval.analysis.metrics import leaves
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import BRIDGE, StageState
from litsim_sim.core.yaml_loader import load_yaml
from litsim_sim.io.yaml_input import parse_yaml
from litsim_sim.record.bag import BagReader
from litsim_sim.record.digest import RunDigest
from litsim_sim.record.run import NET_FILE, RECORDING_FILE, SCENARIO_FILE
from litsim_sim.record.seal import RunFacts, read_seal
from litsim_sim.ros.definitions import type_hash, type_name
from litsim_sim.ros.topics import AGENTS, CONTROLS, EGO_APPLIED, EGO_CONTROL, FORECASTS, RUN_INFO, STATUS, TAKEOVERS
from litsim_sim.scenario.run_info import versions
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.scenario.scenario_file import ScenarioFile

ATTACHED = {"recording": RECORDING_FILE, "net": NET_FILE}
"""Attachments by the field of the scenario that they replace."""

PER_STEP = (AGENTS, FORECASTS, TAKEOVERS, CONTROLS, EGO_CONTROL)


@dataclass(frozen=True)
class Record:
    """A recorded run that can be repeated.

    Attributes:
        path: of the MCAP file.
        info: the recorded ``RunInfo``.
        scenario: rebuilt from the attachments.
        messages: by topic and step; the first one of each step.
        parameters: by stage and dotted name, of the stages that have reported them.
        notes: reasons why a repetition may differ.
    """

    path: Path
    info: Any
    scenario: Scenario
    messages: dict[str, dict[int, Any]]
    parameters: dict[str, dict[str, Any]]
    notes: list[str] = field(default_factory=list)


@contextmanager
def open_record(bag: Path) -> Iterator[Record]:
    """Reads a bag; the files of its scenario are in a temporary folder until the context is left.

    Raises:
        InputError: it is not a bag or not a LitSim run, lacks attachments, has messages of another version, or is not
            as it was sealed.
    """
    reader = BagReader(bag)
    messages = _decoded(reader)
    info = messages[RUN_INFO.name].get(0)
    if info is None:
        raise InputError(f"{reader.path}: no LitSim run: no message on {RUN_INFO.name}")
    if flaws := read_seal(reader.path).flaws(_facts(messages, info)):
        raise InputError(f"{reader.path}: {'; '.join(flaws)}")
    with tempfile.TemporaryDirectory(prefix="litsim-rerun-") as folder:
        record = Record(
            reader.path,
            info,
            _scenario(reader, Path(folder)),
            messages,
            _parameters(info, messages[STATUS.name]),
        )
        _note(record, reader)
        yield record


def _decoded(reader: BagReader) -> dict[str, dict[int, Any]]:
    """Returns messages by topic and step; run information as step 0, stage states numbered in order."""
    wanted = {topic.name: topic for topic in (RUN_INFO, STATUS, *PER_STEP, EGO_APPLIED)}
    for name, topic in wanted.items():
        here, there = type_hash(type_name(topic.type)), reader.topics[name].type_hash if name in reader.topics else ""
        if here and there and here != there:
            raise InputError(f"{reader.path}: {name} was recorded with another version of {type_name(topic.type)}")
    messages: dict[str, dict[int, Any]] = {name: {} for name in wanted}
    for message in reader.messages(wanted):
        of_topic = messages[message.topic]
        try:
            decoded = deserialize_message(message.data, wanted[message.topic].type)
        except Exception as error:  # rclpy exports no class of the middleware's exceptions
            where = f"{reader.path}: {message.topic} at {message.log_time_ns * 1e-9:.1f} s"
            what = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise InputError(f"{where}: not a readable {type_name(wanted[message.topic].type)}: {what}") from error
        info = messages[RUN_INFO.name].get(0)
        if message.topic in (RUN_INFO.name, STATUS.name):
            of_topic.setdefault(0 if message.topic == RUN_INFO.name else len(of_topic), decoded)
        elif info is None or decoded.run_id == info.run_id:
            of_topic.setdefault(decoded.step, decoded)
    if applied := messages.pop(EGO_APPLIED.name):  # for an external ego, the commands that the bridge has applied
        messages[EGO_CONTROL.name] = applied
    return messages


def _facts(messages: dict[str, dict[int, Any]], info: Any) -> RunFacts:
    """Returns what the run came to by its messages."""
    total = RunDigest()
    for step in sorted(messages[AGENTS.name]):
        digest_step(total, messages, step)
    ends = [s for s in messages[STATUS.name].values() if s.stage == BRIDGE and s.state == StageState.FINISHED]
    wall_s, summary = (ends[-1].compute_time, ends[-1].text) if ends else (0.0, "")
    return RunFacts(info.run_id, max(messages[AGENTS.name], default=-1), total.hexdigest(), wall_s, summary)


def digest_step(digest: RunDigest, messages: dict[str, dict[int, Any]], step: int) -> None:
    """Adds the recorded messages of `step` to `digest`."""
    agents, controls, ego = (messages[topic.name].get(step) for topic in (AGENTS, CONTROLS, EGO_CONTROL))
    if agents is not None:
        digest.update(
            AgentTable.of_message(agents),
            None if controls is None else ControlTable.of_message(controls),
            None if ego is None else EgoCommand.of_message(ego),
        )


def _scenario(reader: BagReader, folder: Path) -> Scenario:
    """Returns the scenario with recording and net from the bag; the attached recording is already cropped."""
    lacking = [name for name in (SCENARIO_FILE, *ATTACHED.values()) if name not in reader.attachments]
    if lacking:
        raise InputError(f"{reader.path}: cannot be repeated without attachment {', '.join(lacking)}")
    where = f"{reader.path}: attachment {SCENARIO_FILE}"
    values = parse_yaml(reader.attachments[SCENARIO_FILE], where, ScenarioFile)
    names = ATTACHED | {"net": Path(str(values.get("net"))).name}  # that of the recording, if that has signals of it
    for name, file in ATTACHED.items():
        (folder / names[name]).write_bytes(reader.attachments[file])
    values |= {name: str(folder / file) for name, file in names.items()} | {"crop": None}
    return Scenario.from_yaml(yaml.safe_dump(values), where)


def _parameters(info: Any, statuses: dict[int, Any]) -> dict[str, dict[str, Any]]:
    """Returns parameters by stage, from the run's configuration and from the stages' status when ready."""
    parameters = {
        name: leaves(values) for name, values in _mapping(info.configuration).items() if isinstance(values, dict)
    }
    for status in statuses.values():
        if status.state == StageStatus.READY and (values := _mapping(status.text)):
            inner = values.get(status.stage)
            parameters[status.stage] = leaves(inner if isinstance(inner, dict) else values)
    return parameters


def _mapping(text: str) -> dict[str, Any]:
    try:
        values = load_yaml(text)
    except yaml.YAMLError:
        return {}
    return values if isinstance(values, dict) else {}


def _note(record: Record, reader: BagReader) -> None:
    if not reader.complete:
        record.notes.append(f"the recording is not complete ({reader.problem}); its readable part is used")
    if record.scenario.total_steps != record.info.total_steps:
        record.notes.append(f"{record.info.total_steps} steps were run, {record.scenario.total_steps} are attached")
    then, now = _mapping(record.info.versions).get("commit"), versions()["commit"]
    if then != now:
        record.notes.append(f"recorded with commit {then}, this is {now}")
    agents = record.messages[AGENTS.name]
    ending = [said.step for said in record.messages[STATUS.name].values() if said.state == StageState.ENDING]
    expected = min([*ending, record.info.total_steps])
    if (last := max(agents, default=-1)) < expected:
        record.notes.append(f"the record ends at step {last} of {expected}")
    missed = [step for step in agents if step not in record.messages[EGO_CONTROL.name]]
    if missed:
        record.notes.append(f"{len(missed)} steps lack the ego's answer, the first is {min(missed)}")
