"""Answers and states that the bridge waits for, and the handling of missing ones. Without ROS.

:class:`StageLiveness` holds the states of the stages; :class:`ResponseCollector` collects the answers to the current
step, checks them, and decides what happens if one is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

from litsim_sim.core.checks import check_columns
from litsim_sim.core.errors import printable, shown
from litsim_sim.core.lockstep import RECORDER_WINDOW, Gate
from litsim_sim.core.scene import AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import BRIDGE, EGO, POLICY_STAGES, RECORDER, StageState
from litsim_sim.core.topic_names import CONTROLS, EGO_CONTROL, RECORDED, RUN_INFO
from litsim_sim.ego_port.port import COUNTS, AnswerInvalid, EgoPort, ego_state


class RunFailed(Exception):
    """The run cannot continue; the message says what was missing, and where, and is :func:`printable`."""

    def __init__(self, text: str) -> None:
        super().__init__(printable(text))


class StageLiveness:
    """Reported states of the stages of a run: ready, failed, and progress; messages of other runs are ignored.

    Attributes:
        recorded: newest step up to which the recorder has confirmed its record; -1 before the first.
        recorder_done: whether the recorder has closed its file, complete or not.
    """

    def __init__(self, run_id: str, stages: Sequence[str]) -> None:
        """`stages` are those that take part, including the recorder."""
        self.recorded = -1
        self.recorder_done = False
        self._run_id = run_id
        self._stages = tuple(stages)
        self._ready: dict[str, str] = {}  # parameters that each stage has reported
        self._failures: list[str] = []
        self._foreign = ""  # id of another run published in this domain
        self._heard: dict[str, int] = {}  # last step that each stage is known to have answered

    def take_status(self, run_id: str, stage: str, state: int, text: str) -> None:
        """Take the state of a stage: ready, with its parameters; finished; or failed, with the reason.

        Stages that take no part are ignored: idle nodes of another graph. A stage that is ready twice with different
        parameters is two nodes, and the run would depend on which of them answers first.
        """
        if run_id != self._run_id or stage not in self._stages:
            return
        if state == StageState.READY:
            if self._ready.setdefault(stage, text) != text:
                self._failures.append(
                    f"{stage}: two nodes with different parameters answer; each graph needs a domain of its own"
                )
        elif state == StageState.FAILED:
            self._failures.append(f"{stage}: {text}")
        if stage == RECORDER and state in (StageState.FINISHED, StageState.FAILED):
            self.recorder_done = True

    def fail(self, text: str) -> None:
        """Take notice of a failure outside of the stages."""
        self._failures.append(text)

    def take_timing(self, run_id: str, stage: str, step: int) -> None:
        """Take the timing of a stage for a step, which it has thus answered."""
        if run_id == self._run_id and stage != BRIDGE:
            self._heard[stage] = max(step, self._heard.get(stage, -1))

    def take_run(self, run_id: str) -> None:
        """Take notice of a run published in this domain."""
        if run_id != self._run_id:
            self._foreign = run_id

    def take_confirmation(self, run_id: str, step: int) -> None:
        """Take the recorder's confirmation of the record up to `step`."""
        if run_id == self._run_id:
            self.recorded = max(self.recorded, step)

    @property
    def all_ready(self) -> bool:
        """Whether every stage is ready."""
        return set(self._stages) <= set(self._ready)

    @property
    def awaited(self) -> list[str]:
        """Stages that are not ready; the recorder, which waits for all others, only when it is the last."""
        missing = set(self._stages) - set(self._ready)
        return sorted(missing - {RECORDER}) or sorted(missing)

    @property
    def recorder_closing(self) -> bool:
        """Whether there is a recorder that has not closed its file."""
        return RECORDER in self._ready and not self.recorder_done

    def check(self) -> None:
        """Raise RunFailed if stages have failed, with the reason of each, or another bridge or a replay publishes."""
        if self._foreign:
            raise RunFailed(
                f"another bridge or a replay publishes run {shown(self._foreign)} on {RUN_INFO} in the same domain; "
                "each needs a domain of its own"
            )
        if self._failures:
            raise RunFailed("; ".join(self._failures))

    def check_recorded(self, last: int) -> None:
        """Raise RunFailed if the recorder has not confirmed step `last`."""
        if self.recorded < last:
            raise RunFailed(f"{RECORDER}: has confirmed {self._confirmed} of {last} on {RECORDED}")

    def check_recorder_keeps_up(self, step: int) -> None:
        """Raise RunFailed if the recorder is too far behind `step`."""
        if not self.recorder_keeps_up(step):
            raise RunFailed(
                f"{RECORDER}: has confirmed {self._confirmed} on {RECORDED} at step {step}, expected at most "
                f"{RECORDER_WINDOW} steps behind"
            )

    def recorder_keeps_up(self, step: int) -> bool:
        """Returns whether the recorder is not too far behind `step`; step 0 must be confirmed."""
        return self.recorded >= max(0, step - RECORDER_WINDOW)

    def silent(self, step: int, missing: Sequence[str]) -> list[str]:
        """Stages other than the recorder that have not answered `step`; `missing` are the topics without an answer.

        The stages of the policy answer one after the other: of those that have not answered, only the first is silent,
        the others wait for it. If no stage has been heard at all, they cannot be distinguished.
        """
        silent = [stage for stage in self._stages if stage != RECORDER and self._heard.get(stage, -1) < step]
        waiting = [stage for stage in POLICY_STAGES if stage in silent and CONTROLS in missing]
        return waiting[: 1 if self._heard else None] + [EGO] * (EGO in silent and EGO_CONTROL in missing)

    @property
    def _confirmed(self) -> str:
        return "nothing" if self.recorded < 0 else f"only step {self.recorded}"


class ResponseCollector:
    """The answers to the current step: of the policy, if there is one, and of the ego's driver."""

    def __init__(
        self,
        port: EgoPort,
        liveness: StageLiveness,
        convert: Callable[[Any], ControlTable],
        *,
        run_id: str,
        ego_id: int,
        with_policy: bool,
        stop_on_missing: bool,
    ) -> None:
        """Prepare to collect the answers of a run.

        `convert` reads the policy's message, and raises ValueError if it is malformed. Without a policy, the
        background follows the log. Unless `stop_on_missing`, the newest answer stays in force; those to step 0
        are always required.
        """
        self._port = port
        self._liveness = liveness
        self._convert = convert
        self._ego_id = ego_id
        self._stop_on_missing = stop_on_missing
        self._gate, self._with_policy = Gate(run_id), with_policy
        self._command = EgoCommand(-1)  # valid for the step that it names
        self._missed: dict[str, int] = {}

    @property
    def step(self) -> int:
        """The current step; -1 before the first."""
        return self._gate.step

    @property
    def missing(self) -> list[str]:
        """Topics on which an answer is missing."""
        policy = [CONTROLS] if self._with_policy and self._gate.missing else []
        return policy + ([" or ".join(self._port.topics)] if self._port.missing else [])

    @property
    def complete(self) -> bool:
        """Whether all answers are there, and the recorder is not too far behind."""
        return not self.missing and self._liveness.recorder_keeps_up(self.step)

    @property
    def commanded(self) -> bool:
        """Whether the ego's command for the current step has been taken from the port."""
        return self._command.step == self.step

    def open(self, table: AgentTable, *, driven: bool) -> None:
        """Start collecting the answers to the step of `table`; `driven`: whether an answer for the ego is needed."""
        self._gate.open(table.step)
        self._port.open(table.step, ego_state(table, self._ego_id), driven=driven)

    def ask(self) -> None:
        """Note that the current step is published, first or again: one more answer per topic is then legitimate."""
        self._gate.ask()
        self._port.ask()

    def offer_controls(self, run_id: str, step: int, message: Any) -> None:
        """Take an answer of the policy; it is converted only if it is used."""
        self._gate.offer(run_id, step, message)

    def command(self) -> EgoCommand:
        """Returns the ego's command for this step, or the newest one; raises RunFailed if its answer cannot be used."""
        if not self.commanded:
            try:
                self._command = self._port.take()
            except AnswerInvalid as error:
                raise RunFailed(str(error)) from error
        return self._command

    def settle(self, waited_s: float, silent: Callable[[], str]) -> list[str]:
        """Stop waiting: count missing answers, or end the run. Returns the topics without an answer.

        Raises RunFailed if a required answer is missing, with the text of `silent`, or the recorder is too far
        behind.
        """
        missing = self.missing
        if not missing:
            self._liveness.check_recorder_keeps_up(self.step)
        elif self.step == 0 or self._stop_on_missing:
            raise RunFailed(f"no answer to step {self.step} on {', '.join(missing)} within {waited_s:g} s{silent()}")
        for name in missing:
            self._missed[name] = self._missed.get(name, 0) + 1
        return missing

    def controls(self) -> ControlTable:
        """Returns the controls for this step, the newest ones, or none; raises RunFailed if they cannot be used."""
        if self._gate.newest is None:
            return ControlTable.empty(self.step)
        try:
            controls = self._convert(self._gate.newest)
            check_controls(controls, self._ego_id)
        except ValueError as error:
            raise RunFailed(f"the answer to step {self.step} on {CONTROLS} cannot be used: {error}") from error
        return replace(controls, step=self.step)

    def summary(self) -> dict[str, Any]:
        """Counts of `missed` and `stale` answers by topic, and those of the `ego_port`."""
        counts = self._port.counts
        late = counts["late"] + counts["stale"]
        stale = {name: count for name, count in ((CONTROLS, self._gate.stale), (self._port.topics[0], late)) if count}
        port = {"interface": str(self._port.interface)} | {name: counts[name] for name in COUNTS}
        return {"missed": self._missed, "stale": stale, "ego_port": port}


def check_controls(controls: ControlTable, ego_id: int) -> None:
    """Raise ValueError if controls do not pass :func:`check_columns`, or list the ego."""
    columns = [field.name for field in fields(controls) if field.name != "step"]
    check_columns({name: getattr(controls, name) for name in columns})
    if ego_id in controls.id:
        raise ValueError(f"id lists the ego, {ego_id}, which has a port of its own")
