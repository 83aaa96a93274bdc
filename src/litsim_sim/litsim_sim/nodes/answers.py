"""What comes in while the bridge waits, and what follows from it. Without ROS.

:class:`Attendance` knows what the stages have said of themselves, :class:`Answers` which answers to the step at hand
are there, what becomes of a missing one, and whether what came can be used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from litsim_sim.core.columns import check_columns
from litsim_sim.core.lockstep import RECORDER_WINDOW, Gate
from litsim_sim.core.scene import AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import BRIDGE, EGO, POLICY_STAGES, RECORDER, StageState
from litsim_sim.core.topic_names import CONTROLS, EGO_CONTROL, RECORDED, RUN_INFO
from litsim_sim.ego_port.port import COUNTS, AnswerInvalid, EgoPort, ego_state


class RunFailed(Exception):
    """The run cannot go on; the message says what was missing, and where."""


class Attendance:
    """What the stages of a run have said of themselves: ready, failed, how far they are. Of other runs nothing counts.

    Attributes:
        recorded: newest step up to which the recorder has confirmed its record; -1 before the first.
        recorder_done: whether the recorder has closed its file, for better or worse.
    """

    def __init__(self, run_id: str, stages: Sequence[str]) -> None:
        """Begin with no stage heard; `stages` take part, the recorder included if it does."""
        self.recorded = -1
        self.recorder_done = False
        self._run_id = run_id
        self._stages = tuple(stages)
        self._ready: dict[str, str] = {}  # what each stage has said of its parameters
        self._failures: list[str] = []
        self._foreign = ""  # another run that is published here
        self._heard: dict[str, int] = {}  # last step that each stage is known to have answered

    def take_status(self, run_id: str, stage: str, state: int, text: str) -> None:
        """A stage says that it is ready, with its parameters, has finished or has failed, and then why.

        A stage that takes no part is an idle node of another graph. One that is ready twice, with other parameters, is
        two nodes, and the run would depend on which of them answers first.
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

    def take_timing(self, run_id: str, stage: str, step: int) -> None:
        """A stage says how long it took for a step, and so that it has answered it."""
        if run_id == self._run_id and stage != BRIDGE:
            self._heard[stage] = max(step, self._heard.get(stage, -1))

    def take_run(self, run_id: str) -> None:
        """A node publishes the run `run_id`."""
        if run_id != self._run_id:
            self._foreign = run_id

    def take_confirmation(self, run_id: str, step: int) -> None:
        """The recorder confirms the record up to `step`."""
        if run_id == self._run_id:
            self.recorded = max(self.recorded, step)

    @property
    def all_ready(self) -> bool:
        """Whether every stage has said that it is ready."""
        return set(self._stages) <= set(self._ready)

    @property
    def awaited(self) -> list[str]:
        """Stages that have not said that they are ready; the recorder, which waits for all others, only as the last."""
        missing = set(self._stages) - set(self._ready)
        return sorted(missing - {RECORDER}) or sorted(missing)

    @property
    def recorder_closing(self) -> bool:
        """Whether there is a recorder that has not closed its file yet."""
        return RECORDER in self._ready and not self.recorder_done

    def check(self) -> None:
        """See that no stage has failed, and that there is no other run.

        Raises:
            RunFailed: some have, and the message quotes each of them; or another bridge or a replay publishes.
        """
        if self._foreign:
            raise RunFailed(
                f"another bridge or a replay publishes run {self._foreign} on {RUN_INFO} in the same domain; "
                "each needs a domain of its own"
            )
        if self._failures:
            raise RunFailed("; ".join(self._failures))

    def check_recorded(self, last: int) -> None:
        """See that the recorder, if there is one, has confirmed the step `last`.

        Raises:
            RunFailed: it has not.
        """
        if RECORDER in self._stages and self.recorded < last:
            raise RunFailed(f"{RECORDER}: has confirmed {self._confirmed} of {last} on {RECORDED}")

    def check_recorder_keeps_up(self, step: int) -> None:
        """See that the bridge may go on after `step`.

        Raises:
            RunFailed: the recorder is too far behind.
        """
        if not self.recorder_keeps_up(step):
            raise RunFailed(
                f"{RECORDER}: has confirmed {self._confirmed} on {RECORDED} at step {step}, expected at most "
                f"{RECORDER_WINDOW} steps behind"
            )

    def recorder_keeps_up(self, step: int) -> bool:
        """Whether the recorder is not too far behind `step`; behind step 0 it may not be at all."""
        return self.recorded >= max(0, step - RECORDER_WINDOW)

    def silent(self, step: int, missing: Sequence[str]) -> list[str]:
        """Stages other than the recorder that have not answered `step`; `missing` are the topics without an answer.

        A step goes from one stage of the policy to the next: of those that have not answered it, all but the first wait
        themselves. If no stage has been heard at all, they cannot be told apart.
        """
        silent = [stage for stage in self._stages if stage != RECORDER and self._heard.get(stage, -1) < step]
        waiting = [stage for stage in POLICY_STAGES if stage in silent and CONTROLS in missing]
        return waiting[: 1 if self._heard else None] + [EGO] * (EGO in silent and EGO_CONTROL in missing)

    @property
    def _confirmed(self) -> str:
        return "nothing" if self.recorded < 0 else f"only step {self.recorded}"


@dataclass(frozen=True)
class EgoPublisher:
    """A publisher on one of the topics of the ego port.

    Attributes:
        topic: its name.
        node: full name of its node; empty where that is not known.
        reliable: whether the bridge can hear it.
    """

    topic: str
    node: str
    reliable: bool


def absence(port: EgoPort, there: Sequence[EgoPublisher], known: Sequence[str], domain: str) -> str:
    """In words, why an external ego has not answered the step at hand, as far as it can be told.

    Args:
        port: has heard it, or has not.
        there: its publishers that are announced now.
        known: names of the nodes whose publishers have ever been announced.
        domain: where it should be, in words.
    """
    name = ", ".join(dict.fromkeys([each.node for each in there if each.node] or known))
    who = f"{name}: " if name else ""
    deaf = [each for each in there if not each.reliable]
    if port.unfit:
        return f"{who}it does not answer this step: {port.unfit}"
    if not port.heard and deaf:
        return f"{who}its publisher on {deaf[0].topic} is BEST_EFFORT and cannot be heard, expected RELIABLE"
    if not port.heard and not there:
        return f"{who}nobody publishes on {' or '.join(port.topics)}; is it running in {domain}?"
    if not port.heard:
        return f"{who}it publishes on {there[0].topic}, but nothing has come"
    until = f"{who}it has answered until step {port.answered}"
    if not there:
        return f"{until}; its publisher has left"
    return f"{until}; its publisher is still announced, so it hangs, or has died without leaving"


class Answers:
    """The answers to the step at hand: of the policy, if one moves the background, and of whatever drives the ego."""

    def __init__(
        self,
        port: EgoPort,
        attendance: Attendance,
        convert: Callable[[Any], ControlTable],
        *,
        run_id: str,
        ego_id: int,
        with_policy: bool,
        stop_on_missing: bool,
    ) -> None:
        """Wait for the answers of a run.

        Args:
            port: takes the answers for the ego.
            attendance: knows how far the recorder is.
            convert: reads the policy's message; raises ValueError where it cannot.
            run_id: answers to other runs are stale.
            ego_id: the ego, which no policy controls.
            with_policy: whether a policy answers; otherwise the log alone moves the background.
            stop_on_missing: whether a missing answer ends the run; otherwise the newest one stays in force. To
                step 0 all answers have to come.
        """
        self._port = port
        self._attendance = attendance
        self._convert = convert
        self._ego_id = ego_id
        self._stop_on_missing = stop_on_missing
        self._gate = Gate(run_id, (CONTROLS,) if with_policy else ())
        self._command = EgoCommand(-1)  # for the step that it names
        self._missed: dict[str, int] = {}

    @property
    def step(self) -> int:
        """The step at hand; -1 before the first."""
        return self._gate.step

    @property
    def missing(self) -> list[str]:
        """Topics on which an answer is still waited for."""
        return self._gate.missing + ([" or ".join(self._port.topics)] if self._port.missing else [])

    @property
    def complete(self) -> bool:
        """Whether all answers are in, and the recorder is not too far behind."""
        return not self.missing and self._attendance.recorder_keeps_up(self.step)

    @property
    def commanded(self) -> bool:
        """Whether the command of the ego for the step at hand has been taken from the port."""
        return self._command.step == self.step

    def open(self, table: AgentTable, *, driven: bool) -> None:
        """Wait for the answers to the step of `table`; `driven` says whether that for the ego counts."""
        self._gate.open(table.step)
        self._port.open(table.step, ego_state(table, self._ego_id), driven=driven)

    def ask(self) -> None:
        """The step at hand is published, maybe again: one answer more to it on each topic is no fault."""
        self._gate.ask()
        self._port.ask()

    def offer_controls(self, run_id: str, step: int, message: Any) -> None:
        """Take an answer of the policy, which is read only if it counts."""
        self._gate.offer(CONTROLS, run_id, step, message)

    def command(self) -> EgoCommand:
        """The ego's command for the step at hand; where its answer is missing, the newest one.

        Raises:
            RunFailed: its answer cannot be used.
        """
        if not self.commanded:
            try:
                self._command = self._port.take()
            except AnswerInvalid as error:
                raise RunFailed(str(error)) from error
        return self._command

    def settle(self, waited_s: float, silent: Callable[[], str]) -> list[str]:
        """Give up waiting: count what is missing, or end the run. Returns the topics without an answer.

        Args:
            waited_s: for how long the answers were waited for [s].
            silent: returns words for which stages have not answered; called only if the run ends.

        Raises:
            RunFailed: an answer is missing that must not, or the recorder is too far behind.
        """
        missing = self.missing
        if not missing:
            self._attendance.check_recorder_keeps_up(self.step)
        elif self.step == 0 or self._stop_on_missing:
            raise RunFailed(f"no answer to step {self.step} on {', '.join(missing)} within {waited_s:g} s{silent()}")
        for name in missing:
            self._missed[name] = self._missed.get(name, 0) + 1
        return missing

    def controls(self) -> ControlTable:
        """The controls for the step at hand; where the answer is missing, the newest one, or none.

        Raises:
            RunFailed: they cannot be used.
        """
        newest = self._gate.newest.get(CONTROLS)
        if newest is None:
            return ControlTable.empty(self.step)
        try:
            controls = self._convert(newest)
            check_controls(controls, self._ego_id)
        except ValueError as error:
            raise RunFailed(f"the answer to step {self.step} on {CONTROLS} cannot be used: {error}") from error
        return replace(controls, step=self.step)

    def summary(self) -> dict[str, Any]:
        """Answers by topic that were `missed` and that came `stale`, and what became of those on the `ego_port`."""
        counts = self._port.counts
        late = counts["late"] + counts["stale"]
        stale = self._gate.stale | ({self._port.topics[0]: late} if late else {})
        port = {"interface": str(self._port.interface)} | {name: counts[name] for name in COUNTS}
        return {"missed": self._missed, "stale": stale, "ego_port": port}


def check_controls(controls: ControlTable, ego_id: int) -> None:
    """See that controls are such as the world expects them from any policy.

    Raises:
        ValueError: they are not.
    """
    check_columns({each.name: getattr(controls, each.name) for each in fields(controls) if each.name != "step"})
    if ego_id in controls.id:
        raise ValueError(f"id lists the ego, {ego_id}, which has a port of its own")
