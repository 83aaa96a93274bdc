"""Stages and whole runs once more, from nothing but a record: do they come out as they did?

Messages are decoded and converted as the nodes do it, and answers are turned into messages again, so that a comparison
sees what subscribers would have seen.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import yaml
from litsim_msgs.msg import StageStatus
from rclpy.serialization import deserialize_message

from litsim_policy.conflict import ConflictConfig
from litsim_policy.difference import Tally
from litsim_policy.ego import Ego, make_ego
from litsim_policy.ego.idm import CAREFUL
from litsim_policy.handback import HandbackConfig
from litsim_policy.messages import takeovers_from_message, takeovers_to_message
from litsim_policy.policies import Policy, make_policy
from litsim_policy.runner import Runner
from litsim_policy.takeover import TakeoverConfig, TakeoverManager
from litsim_policy.yield_policy import YieldConfig
from litsim_predictor.forecast import Predictor
from litsim_predictor.kinematic import KinematicConfig
from litsim_predictor.messages import forecast_from_message, forecast_to_message
from litsim_predictor.models import default_model, make_predictor
from litsim_sim.bag import BagReader
from litsim_sim.digest import RunDigest
from litsim_sim.errors import InputError
from litsim_sim.ros.definitions import type_hash, type_name
from litsim_sim.ros.messages import (
    agents_from_message,
    agents_to_message,
    controls_from_message,
    controls_to_message,
    ego_from_message,
    ego_to_message,
)
from litsim_sim.ros.topics import (
    AGENTS,
    CONTROLS,
    EGO_APPLIED,
    EGO_CONTROL,
    FORECASTS,
    RUN_INFO,
    STATUS,
    TAKEOVERS,
    Topic,
)
from litsim_sim.run_info import RunPlan, versions
from litsim_sim.scenario import Scenario
from litsim_sim.scene import AgentTable, EgoCommand

ATTACHED = {"recording": "recording.parquet", "net": "net.xml"}
"""Field of the scenario, and the attachment that takes its place."""

SCENARIO_FILE = "scenario.yaml"
EXTERNAL = "external"
PER_STEP = (AGENTS, FORECASTS, TAKEOVERS, CONTROLS, EGO_CONTROL)

_T = TypeVar("_T")


@dataclass(frozen=True)
class Record:
    """A recorded run that can be run again.

    Attributes:
        path: of the MCAP file.
        info: the recorded ``RunInfo``.
        scenario: rebuilt from the attachments.
        messages: by topic and step; of a step that comes twice, the first.
        parameters: of each stage that has told them, flat, by name.
        notes: what keeps a re-run from coming out equal, or may.
    """

    path: Path
    info: Any
    scenario: Scenario
    messages: dict[str, dict[int, Any]]
    parameters: dict[str, dict[str, Any]]
    notes: list[str] = field(default_factory=list)

    def configured(self, stage: str, default: _T, prefix: str = "") -> _T:
        """`default` with what the stage has told of its parameters."""
        return with_parameters(default, self.parameters.get(stage, {}), prefix)


@contextmanager
def open_record(bag: Path) -> Iterator[Record]:
    """Read a bag; its scenario lies in a temporary folder meanwhile.

    Raises:
        InputError: not a bag, no LitSim run, no attachments to build the scenario from, or messages of another version.
    """
    reader = BagReader(bag)
    found = _decoded(reader)
    info = found[RUN_INFO.name].get(0)
    if info is None:
        raise InputError(f"{reader.path}: no LitSim run: no message on {RUN_INFO.name}")
    with tempfile.TemporaryDirectory(prefix="litsim-rerun-") as folder:
        record = Record(
            reader.path,
            info,
            _scenario(reader, Path(folder)),
            found,
            _parameters(info, found[STATUS.name]),
        )
        _note(record, reader)
        yield record


def rerun_stage(record: Record, name: str) -> Tally:
    """Feed a stage its recorded inputs, step by step, and compare its answers with the recorded ones.

    Raises:
        InputError: there is no stage `name`, it took no part in the run, or it fails.
    """
    if name not in STAGES:
        raise InputError(f"there is no stage {name!r}, expected one of {', '.join(STAGES)}")
    stage, info = STAGES[name], record.info
    answers = record.messages[stage.output.name]
    if not answers:
        raise InputError(f"{record.path}: stage {name} has left no answers (ego {info.ego}, policy {info.policy})")
    if name == "ego" and info.ego == EXTERNAL:
        raise InputError(f"{record.path}: the ego is external: its stage is not here to be run again")
    if name not in record.parameters:
        record.notes.append(f"the record does not tell the parameters of {name}: taking the defaults")
    core, tally = stage.make(record), Tally()
    inputs = [record.messages[topic.name] for topic in stage.inputs]
    for step in sorted(set.intersection(*(set(messages) for messages in inputs))):
        try:
            answer = core(*(messages[step] for messages in inputs))
        except Exception as error:
            raise InputError(f"stage {name} fails at step {step}: {type(error).__name__}: {error}") from error
        if step in answers:
            tally.add(stage.output.name, step, answers[step], answer)
    if tally.compared < len(answers):
        record.notes.append(f"{len(answers) - tally.compared} answers lack their inputs in the record")
    return tally


@dataclass
class Resimulated:
    """A run and its record side by side.

    Attributes:
        tally: of agents, takeovers, controls and ego commands, step by step.
        steps: number of steps that both hold.
        recorded, computed: digests over those.
    """

    tally: Tally
    steps: int
    recorded: str
    computed: str


def resimulate(record: Record) -> Resimulated:
    """Run everything again in this process, as far as the record goes; an external ego answers as recorded.

    Raises:
        InputError: the record cannot be run again.
    """
    info, messages, tally = record.info, record.messages, Tally()
    if info.ego == EXTERNAL:
        record.notes.append("the ego is external: it answers as recorded")
    run_id, ego_id = info.run_id, info.ego_id
    compared = [messages[topic.name] for topic in (AGENTS, TAKEOVERS, CONTROLS, EGO_CONTROL)]
    last = min((max(found) for found in compared if found), default=-1)  # what is cut short may end amid a step
    digests = RunDigest(), RunDigest()
    steps = 0
    for now in _Again(record).rounds():
        step = now.table.step
        if step > last:
            break
        steps += 1
        answers = {
            AGENTS.name: agents_to_message(now.table, run_id, info.total_steps, ego_id),
            TAKEOVERS.name: None if now.takeovers is None else takeovers_to_message(now.takeovers, run_id),
            CONTROLS.name: None if now.controls is None else controls_to_message(now.controls, run_id),
            EGO_CONTROL.name: ego_to_message(now.ego, run_id),
        }
        for topic, answer in answers.items():
            if answer is not None and step in messages[topic]:
                tally.add(topic, step, messages[topic][step], answer)
        digests[1].update(now.table, now.controls, now.ego)
        _digest(digests[0], messages, step)
    return Resimulated(tally, steps, digests[0].hexdigest(), digests[1].hexdigest())


def with_parameters(default: _T, given: dict[str, Any], prefix: str = "") -> _T:
    """A frozen dataclass of parameters from their flat names, as ``litsim_sim.ros.parameters.declare`` names them.

    Raises:
        InputError: a value does not fit its field.
    """
    values: dict[str, Any] = {}
    for each in fields(default):  # type: ignore[arg-type]
        name, value = prefix + each.name, getattr(default, each.name)
        if is_dataclass(value):
            values[each.name] = with_parameters(value, given, f"{name}.")
            continue
        try:
            values[each.name] = type(value)(given[name]) if name in given else value
        except (TypeError, ValueError) as error:
            raise InputError(f"recorded parameter {name} is {given[name]!r}, expected such as {value!r}") from error
    return type(default)(**values)


class _Again(Runner):
    """The runner with the stages as they were configured."""

    def __init__(self, record: Record) -> None:
        info = record.info
        ego = "log" if info.ego == EXTERNAL else info.ego  # replaced below
        super().__init__(RunPlan(record.scenario, ego, info.policy))
        self._ego = _RecordedEgo(record.messages[EGO_CONTROL.name]) if info.ego == EXTERNAL else _ego(record)
        if self._reacts:
            silent = [name for name in STAGES if name in info.stages and name not in record.parameters]
            if silent:
                record.notes.append(f"the record does not tell the parameters of {', '.join(silent)}: taking defaults")
            self._predictor, self._manager, self._policy = _predictor(record), _manager(record), _policy(record)


class _RecordedEgo:
    """An ego that answers as recorded; where it has not, as before."""

    def __init__(self, commands: dict[int, Any]) -> None:
        self._commands, self._last = commands, EgoCommand(0)

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.Ego`."""
        if table.step in self._commands:
            self._last = ego_from_message(self._commands[table.step])
        return replace(self._last, step=table.step)


@dataclass(frozen=True)
class Stage:
    """A stage as its node shows it.

    Attributes:
        inputs, output: topics.
        make: its core for a record, from input messages to the answer.
    """

    inputs: tuple[Topic, ...]
    output: Topic
    make: Callable[[Record], Callable[..., Any]]


def _predictor(record: Record) -> Predictor:
    model = str(record.parameters.get("predictor", {}).get("model", default_model()))
    return make_predictor(model, record.scenario, record.configured("predictor", KinematicConfig(), "kinematic."))


def _manager(record: Record) -> TakeoverManager:
    return TakeoverManager(
        record.scenario,
        record.configured("conflict", ConflictConfig()),
        record.configured("conflict", TakeoverConfig()),
    )


def _policy(record: Record) -> Policy:
    return make_policy(
        record.info.policy,
        record.scenario,
        record.configured("policy", YieldConfig()),
        record.configured("policy", HandbackConfig(), "handback."),
    )


def _ego(record: Record) -> Ego:
    return make_ego(record.info.ego, record.scenario, record.configured("ego", CAREFUL))


def _predictor_stage(record: Record) -> Callable[..., Any]:
    core = _predictor(record)
    return lambda agents: forecast_to_message(core.forecast(agents_from_message(agents)), record.info.run_id)


def _conflict_stage(record: Record) -> Callable[..., Any]:
    core = _manager(record)
    return lambda agents, forecast: takeovers_to_message(
        core.update(agents_from_message(agents), forecast_from_message(forecast)), record.info.run_id
    )


def _policy_stage(record: Record) -> Callable[..., Any]:
    core = _policy(record)
    return lambda agents, takeovers: controls_to_message(
        core.act(agents_from_message(agents), takeovers_from_message(takeovers)), record.info.run_id
    )


def _ego_stage(record: Record) -> Callable[..., Any]:
    core = _ego(record)
    return lambda agents: ego_to_message(core.plan(agents_from_message(agents)), record.info.run_id)


STAGES = {
    "predictor": Stage((AGENTS,), FORECASTS, _predictor_stage),
    "conflict": Stage((AGENTS, FORECASTS), TAKEOVERS, _conflict_stage),
    "policy": Stage((AGENTS, TAKEOVERS), CONTROLS, _policy_stage),
    "ego": Stage((AGENTS,), EGO_CONTROL, _ego_stage),
}


def _decoded(reader: BagReader) -> dict[str, dict[int, Any]]:
    """Messages by topic and step; run information as step 0, stage states numbered as they come."""
    wanted = {topic.name: topic for topic in (RUN_INFO, STATUS, *PER_STEP, EGO_APPLIED)}
    for name, topic in wanted.items():
        here, there = type_hash(type_name(topic.type)), reader.topics[name].type_hash if name in reader.topics else ""
        if here and there and here != there:
            raise InputError(f"{reader.path}: {name} was recorded with another version of {type_name(topic.type)}")
    found: dict[str, dict[int, Any]] = {name: {} for name in wanted}
    for message in reader.messages(wanted):
        decoded, kept = deserialize_message(message.data, wanted[message.topic].type), found[message.topic]
        info = found[RUN_INFO.name].get(0)
        if message.topic in (RUN_INFO.name, STATUS.name):
            kept.setdefault(0 if message.topic == RUN_INFO.name else len(kept), decoded)
        elif info is None or decoded.run_id == info.run_id:
            kept.setdefault(decoded.step, decoded)
    if applied := found.pop(EGO_APPLIED.name):  # of an external ego counts what the bridge made of its answers
        found[EGO_CONTROL.name] = applied
    return found


def _scenario(reader: BagReader, folder: Path) -> Scenario:
    """The scenario with recording and net from the bag; the recording is cropped already."""
    lacking = [name for name in (SCENARIO_FILE, *ATTACHED.values()) if name not in reader.attachments]
    if lacking:
        raise InputError(f"{reader.path}: cannot be run again without attachment {', '.join(lacking)}")
    for name in ATTACHED.values():
        (folder / name).write_bytes(reader.attachments[name])
    where = f"{reader.path}: attachment {SCENARIO_FILE}"
    try:
        values = yaml.safe_load(reader.attachments[SCENARIO_FILE])
    except yaml.YAMLError as error:
        raise InputError(f"{where}: malformed YAML: {' '.join(str(error).split())}") from error
    if not isinstance(values, dict):
        raise InputError(f"{where}: expected the fields of a scenario")
    values |= {name: str(folder / file) for name, file in ATTACHED.items()} | {"crop": None}
    return Scenario.from_yaml(yaml.safe_dump(values), where)


def _parameters(info: Any, statuses: dict[int, Any]) -> dict[str, dict[str, Any]]:
    """What the stages have told of their parameters: in the run's configuration, or when they were ready."""
    told = {name: _flat(values) for name, values in _mapping(info.configuration).items() if isinstance(values, dict)}
    for status in statuses.values():
        if status.state == StageStatus.READY and (values := _mapping(status.text)):
            inner = values.get(status.stage)
            told[status.stage] = _flat(inner if isinstance(inner, dict) else values)
    return told


def _mapping(text: str) -> dict[str, Any]:
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError:
        return {}
    return values if isinstance(values, dict) else {}


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return found


def _note(record: Record, reader: BagReader) -> None:
    if not reader.complete:
        record.notes.append(f"the recording is not complete ({reader.problem}): as far as it goes")
    if record.scenario.total_steps != record.info.total_steps:
        record.notes.append(f"{record.info.total_steps} steps were run, {record.scenario.total_steps} are attached")
    then, now = _mapping(record.info.versions).get("commit"), versions()["commit"]
    if then != now:
        record.notes.append(f"recorded with commit {then}, this is {now}")
    agents = record.messages[AGENTS.name]
    if (last := max(agents, default=-1)) < record.info.total_steps:
        record.notes.append(f"the record ends at step {last} of {record.info.total_steps}")
    missed = [step for step in agents if step not in record.messages[EGO_CONTROL.name]]
    if missed:
        record.notes.append(f"{len(missed)} steps lack the ego's answer, the first is {min(missed)}")


def _digest(digest: RunDigest, messages: dict[str, dict[int, Any]], step: int) -> None:
    """Take in a step as it is recorded."""
    agents, controls, ego = (messages[topic.name].get(step) for topic in (AGENTS, CONTROLS, EGO_CONTROL))
    if agents is not None:
        digest.update(
            agents_from_message(agents),
            None if controls is None else controls_from_message(controls),
            None if ego is None else ego_from_message(ego),
        )
