"""A recorded run with the messages, scenario and parameters needed to repeat it, or one of its stages."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rclpy.serialization import deserialize_message

from litsim_eval.analysis.measures.identity import digest
from litsim_eval.analysis.metrics import leaves
from litsim_sim.core.errors import InputError
from litsim_sim.core.stages import StageState
from litsim_sim.core.yaml_loader import load_yaml
from litsim_sim.io.yaml_input import parse_yaml
from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import NET_FILE, RECORDING_FILE, SCENARIO_FILE, Run, read_run
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
        run: as it was read.
        scenario: rebuilt from the attachments.
        messages: by topic and step; the first one of each step. Of an external ego, or one whose answers count later,
            they are what the bridge has applied.
        parameters: by stage and dotted name, of the stages that have reported them.
        notes: reasons why a repetition may differ.
    """

    run: Run
    scenario: Scenario
    messages: dict[str, dict[int, Any]]
    parameters: dict[str, dict[str, Any]]
    notes: list[str]


@contextmanager
def open_record(bag: Path) -> Iterator[Record]:
    """Reads a bag; the files of its scenario are in a temporary folder until the context is left.

    Raises:
        InputError: it is not a bag or not a LitSim run, lacks attachments, has messages of another version, or is not
            as it was sealed.
    """
    reader = BagReader(bag)
    for topic in (RUN_INFO, STATUS, *PER_STEP, EGO_APPLIED):
        name, recorded = type_name(topic.type), reader.topics.get(topic.name)
        here, there = type_hash(name), recorded.type_hash if recorded else ""
        if here and there and here != there:
            raise InputError(f"{reader.path}: {topic.name} was recorded with another version of {name}")
    run = read_run(bag)
    if run.seal is not None and (flaws := run.seal.flaws(run.facts(digest(run)))):
        raise InputError(f"{run.path}: {'; '.join(flaws)}")
    with tempfile.TemporaryDirectory(prefix="litsim-rerun-") as folder:
        scenario, messages = _scenario(reader, Path(folder)), _decoded(reader, run)
        yield Record(run, scenario, messages, _parameters(run), _notes(run, scenario, messages))


def _decoded(reader: BagReader, run: Run) -> dict[str, dict[int, Any]]:
    """Returns messages of the `run` by topic and step."""
    wanted = {topic.name: topic for topic in PER_STEP}
    applied = EGO_APPLIED.name in run.info.topics
    if applied:
        wanted[EGO_APPLIED.name] = EGO_APPLIED
    messages: dict[str, dict[int, Any]] = {name: {} for name in wanted}
    for message in reader.messages(wanted):
        try:
            decoded = deserialize_message(message.data, wanted[message.topic].type)
        except Exception as error:  # rclpy exports no class of the middleware's exceptions
            where = f"{reader.path}: {message.topic} at {message.log_time_ns * 1e-9:.1f} s"
            what = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise InputError(f"{where}: not a readable {type_name(wanted[message.topic].type)}: {what}") from error
        if decoded.run_id == run.info.run_id:
            messages[message.topic].setdefault(decoded.step, decoded)
    if applied:
        messages[EGO_CONTROL.name] = messages.pop(EGO_APPLIED.name)
    return messages


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


def _parameters(run: Run) -> dict[str, dict[str, Any]]:
    """Returns parameters by stage, from the run's configuration and from the stages' status when ready."""
    configuration = _mapping(run.info.configuration)
    parameters = {name: leaves(values) for name, values in configuration.items() if isinstance(values, dict)}
    for status in run.statuses:
        if status.state == StageState.READY and (values := _mapping(status.text)):
            inner = values.get(status.stage)
            parameters[status.stage] = leaves(inner if isinstance(inner, dict) else values)
    return parameters


def _mapping(text: str) -> dict[str, Any]:
    try:
        values = load_yaml(text)
    except yaml.YAMLError:
        return {}
    return values if isinstance(values, dict) else {}


def _notes(run: Run, scenario: Scenario, messages: dict[str, dict[int, Any]]) -> list[str]:
    """Returns reasons why a repetition may differ."""
    notes = []
    if not run.complete:
        notes.append(f"the recording is not complete ({run.problem}); its readable part is used")
    if scenario.total_steps != run.info.total_steps:
        notes.append(f"{run.info.total_steps} steps were run, {scenario.total_steps} are attached")
    then, now = _mapping(run.info.versions).get("commit"), versions()["commit"]
    if then != now:
        notes.append(f"recorded with commit {then}, this is {now}")
    ending = [status.step for status in run.statuses if status.state == StageState.ENDING]
    expected = min([*ending, run.info.total_steps])
    if (last := run.tables[-1].step) < expected:
        notes.append(f"the record ends at step {last} of {expected}")
    missed = [step for step in messages[AGENTS.name] if step not in messages[EGO_CONTROL.name]]
    if missed:
        notes.append(f"{len(missed)} steps lack the ego's answer, the first is {min(missed)}")
    return notes
