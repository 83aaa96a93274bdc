"""Repetition of a stage or a whole run from its record, and comparison with the record.

Messages are decoded and converted as in the nodes, and answers are converted back to messages, so that the comparison
covers exactly what subscribers receive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from litsim_eval.runs.message_diff import DiffSummary
from litsim_eval.runs.recorded_run import Record
from litsim_policy.conflict.messages import takeovers_to_message
from litsim_policy.ego.ego import Ego
from litsim_predictor.ros.messages import forecast_from_message, forecast_to_message
from litsim_sim.core.errors import InputError
from litsim_sim.core.latency import NAME, NONE, latency_in
from litsim_sim.core.plugins import configured_stages
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.core.stages import BRIDGE, CONFLICT, EGO, POLICY, PREDICTOR
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.record.digest import RunDigest
from litsim_sim.ros.messages import (
    agents_to_message,
    controls_to_message,
    ego_to_message,
)
from litsim_sim.ros.topics import AGENTS, CONTROLS, EGO_CONTROL, FORECASTS, TAKEOVERS, Topic
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan
from litsim_sim.simulation import Simulation


def rerun_stage(record: Record, name: str) -> DiffSummary:
    """Feeds a stage its recorded inputs, step by step, and compares its answers with the recorded ones.

    Raises:
        InputError: the stage `name` does not exist, took no part in the run, is external, or fails.
    """
    if name not in STAGES:
        raise InputError(f"there is no stage {name!r}, expected one of {', '.join(STAGES)}")
    stage, info = STAGES[name], record.run.info
    answers = record.messages[stage.output.name]
    if not answers:
        raise InputError(f"{record.run.path}: no answers of stage {name} (ego {info.ego}, policy {info.policy})")
    if name == EGO and info.ego == EXTERNAL:
        raise InputError(f"{record.run.path}: the ego is external, and its stage cannot be repeated")
    if name not in record.parameters:
        record.notes.append(f"the record lacks the parameters of {name}; the defaults are used")
    core, tally = _core(record, name), DiffSummary()
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
    """Comparison of a repeated run with its record.

    Attributes:
        tally: differences of agents, takeovers, controls and ego commands.
        steps: number of steps in both.
        recorded, computed: digests over these steps.
    """

    tally: DiffSummary
    steps: int
    recorded: str
    computed: str


def resimulate(record: Record) -> Resimulated:
    """Repeats the run in this process, as far as the record goes; an external ego answers as recorded.

    Raises:
        InputError: the record cannot be used.
    """
    run, messages, tally = record.run, record.messages, DiffSummary()
    info, recorded = run.info, {table.step: table for table in run.tables}
    if info.ego == EXTERNAL:
        record.notes.append("the ego is external: it answers as recorded")
    run_id, ego_id = info.run_id, info.ego_id
    compared = (AGENTS, EGO_CONTROL) if info.policy == "replay" else (AGENTS, TAKEOVERS, CONTROLS, EGO_CONTROL)
    last = min(max(messages[topic.name], default=-1) for topic in compared)  # a truncated bag may end within a step
    if last < 0:
        raise InputError(f"{record.run.path}: has no complete step, so there is nothing to repeat")
    digests = RunDigest(), RunDigest()
    steps = 0
    for now in _again(record).steps():
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
        if step in recorded:
            digests[0].update(recorded[step], run.controls.get(step), run.ego_commands.get(step))
    return Resimulated(tally, steps, digests[0].hexdigest(), digests[1].hexdigest())


def _again(record: Record) -> Simulation:
    """Returns the recorded plan, with the recorded parameters, as a simulation at its step 0."""
    info = record.run.info
    external = info.ego == EXTERNAL
    silent = [name for name in STAGES if name in info.stages and name not in record.parameters]
    if silent:
        record.notes.append(f"the record lacks the parameters of {', '.join(silent)}; the defaults are used")
    ego = _RecordedEgo(record.run.ego_commands) if external else None
    parameters = {name: values for name, values in record.parameters.items() if name in STAGES}
    if not external and (latency := latency_in(record.parameters)) != NONE:
        parameters[BRIDGE] = {NAME: latency}
    return Simulation.of(RunPlan(record.scenario, info.ego, info.policy, parameters), ego=ego)


class _RecordedEgo(Ego):
    """An ego that answers each step as recorded, or repeats the previous answer if there is none."""

    def __init__(self, commands: Mapping[int, EgoCommand]) -> None:
        self._commands, self._last = commands, EgoCommand(0)

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.ego.Ego`."""
        self._last = self._commands.get(table.step, self._last)
        return replace(self._last, step=table.step)


class Stage(NamedTuple):
    """Topics of a stage, the method of its core that answers, and the function that makes a message of the answer."""

    inputs: tuple[Topic, ...]
    output: Topic
    method: str
    to_message: Callable[[Any, str], Any]


STAGES = {
    PREDICTOR: Stage((AGENTS,), FORECASTS, "forecast", forecast_to_message),
    CONFLICT: Stage((AGENTS, FORECASTS), TAKEOVERS, "update", takeovers_to_message),
    POLICY: Stage((AGENTS, TAKEOVERS), CONTROLS, "act", controls_to_message),
    EGO: Stage((AGENTS,), EGO_CONTROL, "plan", ego_to_message),
}
FROM_MESSAGE: dict[str, Callable[[Any], Any]] = {
    AGENTS.name: AgentTable.of_message,
    FORECASTS.name: forecast_from_message,
    TAKEOVERS.name: TakeoverTable.of_message,
}
"""Functions that decode the inputs of stages, by topic."""


def _core(record: Record, name: str) -> Callable[..., Any]:
    """Returns the function from input messages to the answer of a stage, set up with the recorded parameters."""
    stage, info = STAGES[name], record.run.info
    make = configured_stages((name,), {name: record.parameters.get(name, {})}, info.ego)[name]
    core = make(record.scenario) if name == EGO else make(info.policy, record.scenario)

    def answer(*messages: Any) -> Any:
        inputs = (FROM_MESSAGE[topic.name](message) for topic, message in zip(stage.inputs, messages, strict=True))
        return stage.to_message(getattr(core, stage.method)(*inputs), info.run_id)

    return answer
