"""Answers and states that the bridge waits for, and the handling of missing ones. Without ROS.

:class:`StageLiveness` holds the states of the stages; :class:`ResponseCollector` collects the answers to the current
step, checks them, and decides what happens if one is missing.
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

PARTICIPANT_BYTES = 12  # length of the prefix of a GUID of DDS


class RunFailed(Exception):
    """The run cannot continue; the message says what was missing, and where."""


class StageLiveness:
    """Reported states of the stages of a run: ready, failed, and progress; messages of other runs are ignored.

    Attributes:
        recorded: newest step up to which the recorder has confirmed its record; -1 before the first.
        recorder_done: whether the recorder has closed its file, complete or not.
    """

    def __init__(self, run_id: str, stages: Sequence[str]) -> None:
        """`stages` are those that take part, including the recorder if it does."""
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
        """Check that no stage has failed, and that there is no other run.

        Raises:
            RunFailed: stages have failed, with the reason of each; or another bridge or a replay publishes.
        """
        if self._foreign:
            raise RunFailed(
                f"another bridge or a replay publishes run {self._foreign} on {RUN_INFO} in the same domain; "
                "each needs a domain of its own"
            )
        if self._failures:
            raise RunFailed("; ".join(self._failures))

    def check_recorded(self, last: int) -> None:
        """Check that the recorder, if there is one, has confirmed step `last`.

        Raises:
            RunFailed: it has not.
        """
        if RECORDER in self._stages and self.recorded < last:
            raise RunFailed(f"{RECORDER}: has confirmed {self._confirmed} of {last} on {RECORDED}")

    def check_recorder_keeps_up(self, step: int) -> None:
        """Check that the recorder is not too far behind `step`.

        Raises:
            RunFailed: the recorder is too far behind.
        """
        if not self.recorder_keeps_up(step):
            raise RunFailed(
                f"{RECORDER}: has confirmed {self._confirmed} on {RECORDED} at step {step}, expected at most "
                f"{RECORDER_WINDOW} steps behind"
            )

    def recorder_keeps_up(self, step: int) -> bool:
        """Whether the recorder is not too far behind `step`; step 0 must be confirmed."""
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


@dataclass(frozen=True)
class EgoPublisher:
    """A publisher on one of the topics of the ego port.

    Attributes:
        topic: its name.
        node: full name of its node; empty if unknown.
        unheard: text that says why the bridge cannot hear it; empty if it can.
        gid: identifier that DDS gives it, and no other.
    """

    topic: str
    node: str
    unheard: str = ""
    gid: bytes = b""

    @property
    def participant(self) -> bytes:
        """The part of :attr:`gid` that all publishers of a process have in common."""
        return self.gid[:PARTICIPANT_BYTES]


def absence(
    port: EgoPort, there: Sequence[EgoPublisher], known: Sequence[str], domain: str, *, clock: bool = True
) -> str:
    """Text that says why an external ego has not answered the current step, as far as known.

    Args:
        port: port of the ego.
        there: its currently announced publishers.
        known: names of all nodes with publishers ever announced.
        domain: description of the domain in which it should be.
        clock: whether the bridge publishes the clock.
    """
    name = ", ".join(dict.fromkeys([each.node for each in there if each.node] or known))
    prefix = f"{name}: " if name else ""
    elsewhere = ", ".join(dict.fromkeys(each.topic for each in there if each.topic not in port.topics))
    there = [each for each in there if each.topic in port.topics]
    unheard = [each for each in there if each.unheard]
    if elsewhere and not there and port.answered < 0:
        return f"{prefix}it publishes on {elsewhere}, expected {port.topics[0]}"
    if port.unfit:
        return f"{prefix}it does not answer this step: {port.unfit}"
    if not port.heard and unheard:
        return f"{prefix}its publisher on {unheard[0].topic} {unheard[0].unheard}"
    if not port.heard and not there:
        return f"{prefix}no node publishes on {' or '.join(port.topics)}; is it running in {domain}?"
    if not port.heard:
        about_timers = (
            "; until step 0 is answered, /clock advances to 0.1 s only, so that longer timers on simulation time do "
            "not run"
        )
        text = f"{prefix}it publishes on {there[0].topic}, but no message has been received"
        return text + (about_timers if clock else "")
    end = "is still announced, so it hangs, or has died without leaving" if there else "has left"
    return f"{prefix}it has answered until step {port.answered}; its publisher {end}"


def rivalry(port: EgoPort, there: Sequence[EgoPublisher]) -> str:
    """Text that says that several publishers answer for the ego; empty if there is one, or every answer was asked for.

    Answers on a second input are no matter if they are the same process's, or if the user has chosen the input.

    Args:
        port: port of the ego.
        there: currently announced publishers.
    """
    drivers = [each for each in there if each.topic in port.topics and not each.unheard]
    strangers = _on_other_inputs(port, drivers, there)
    if port.by_first and port.counts["refused"] and drivers and strangers:
        who = ", ".join(sorted(f"{each.node or '?'} on {each.topic}" for each in [*drivers, *strangers]))
        return (
            f"several nodes answer: {who}; it would depend on chance whose first message decides which of them drives "
            "the ego; end the others, or choose with --ego-interface"
        )
    heard = [each.node or "?" for each in drivers]
    unasked = sum(port.counts[kind] for kind in ("stale", "future", "surplus"))
    if len(heard) < 2 or not unasked:
        return ""
    return (
        f"{len(heard)} publishers are on {port.topics[0]} ({', '.join(sorted(heard))}), and {unasked} messages there "
        "were not asked for: it would depend on chance which of them drives the ego; end the others, or choose another "
        "domain"
    )


def _on_other_inputs(
    port: EgoPort, drivers: Sequence[EgoPublisher], there: Sequence[EgoPublisher]
) -> list[EgoPublisher]:
    """The publishers on inputs that are not in use, of other processes and other nodes than the `drivers`."""
    processes, nodes = {each.participant for each in drivers}, {each.node for each in drivers} - {""}
    others = (each for each in there if each.topic not in port.topics and not each.unheard)
    return [each for each in others if each.participant not in processes and each.node not in nodes]


class EgoPublishers:
    """The publishers that have answered for an external ego, to notice a stack that is started again in mid-run.

    It answers on as if nothing had happened, but has not seen the steps before its start.
    """

    def __init__(self) -> None:
        self._known: set[bytes] = set()

    @property
    def met(self) -> bool:
        """Whether any have been noted."""
        return bool(self._known)

    def note(self, port: EgoPort, there: Sequence[EgoPublisher], names: Sequence[str]) -> list[str]:
        """Note the announced publishers. The first call is made when step 0 is answered: none that it finds has joined.

        Args:
            port: port of the ego, which counts those that have joined since.
            there: currently announced publishers.
            names: names of the nodes, of publishers whose node is unknown.

        Returns:
            For each that has joined, a text that says so.
        """
        heard = {each.gid: each for each in there if each.topic in port.topics and not each.unheard}
        joined = [each for gid, each in heard.items() if gid not in self._known] if self._known else []
        self._known |= heard.keys()
        port.counts["joined"] += len(joined)
        return [
            f"{each.node or ', '.join(names) or '?'}: its publisher on {each.topic} was not there at step 0; a stack "
            "that has been started again in mid-run answers without what it knew before"
            for each in joined
        ]


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

        Args:
            port: port of the ego.
            liveness: states of the stages.
            convert: converts the policy's message; raises ValueError if it is malformed.
            run_id: id of the run; answers to other runs are stale.
            ego_id: id of the ego, which no policy controls.
            with_policy: whether a policy answers; else the background follows the log.
            stop_on_missing: whether a missing answer ends the run; else the newest one stays in force. Answers to
                step 0 are always required.
        """
        self._port = port
        self._liveness = liveness
        self._convert = convert
        self._ego_id = ego_id
        self._stop_on_missing = stop_on_missing
        self._gate = Gate(run_id, (CONTROLS,) if with_policy else ())
        self._command = EgoCommand(-1)  # valid for the step that it names
        self._missed: dict[str, int] = {}

    @property
    def step(self) -> int:
        """The current step; -1 before the first."""
        return self._gate.step

    @property
    def missing(self) -> list[str]:
        """Topics on which an answer is missing."""
        return self._gate.missing + ([" or ".join(self._port.topics)] if self._port.missing else [])

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
        self._gate.offer(CONTROLS, run_id, step, message)

    def command(self) -> EgoCommand:
        """The ego's command for the current step; the newest one if its answer is missing.

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
        """Stop waiting: count missing answers, or end the run. Returns the topics without an answer.

        Args:
            waited_s: time waited [s].
            silent: returns a text that names the silent stages; called only if the run ends.

        Raises:
            RunFailed: a required answer is missing, or the recorder is too far behind.
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
        """The controls for the current step; if the answer is missing, the newest ones, or none.

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
        """Counts of `missed` and `stale` answers by topic, and those of the `ego_port`."""
        counts = self._port.counts
        late = counts["late"] + counts["stale"]
        stale = self._gate.stale | ({self._port.topics[0]: late} if late else {})
        port = {"interface": str(self._port.interface)} | {name: counts[name] for name in COUNTS}
        return {"missed": self._missed, "stale": stale, "ego_port": port}


def check_controls(controls: ControlTable, ego_id: int) -> None:
    """Check controls of a policy, whichever it is.

    Raises:
        ValueError: columns differ in length, ids do not ascend or include the ego, or values are not finite.
    """
    check_columns({each.name: getattr(controls, each.name) for each in fields(controls) if each.name != "step"})
    if ego_id in controls.id:
        raise ValueError(f"id lists the ego, {ego_id}, which has a port of its own")
