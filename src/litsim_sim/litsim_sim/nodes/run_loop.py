"""The course of a run: handshake, steps, farewell. Without ROS.

Messages are exchanged through a :class:`Graph`, implemented by the bridge's node.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import closing
from typing import Protocol, Self

import yaml
from tqdm import tqdm

from litsim_sim.core.scene import STEP_S, AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import RECORDER, StageState
from litsim_sim.core.step_marks import step_marks
from litsim_sim.core.topic_names import RECORDED, STATUS
from litsim_sim.ego_port.port import EgoPort
from litsim_sim.nodes.bridge_options import BridgeOptions
from litsim_sim.nodes.responses import ResponseCollector, RunFailed, StageLiveness
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan
from litsim_sim.world.world import World

LOOK_S = 1.0
"""[s] Time from its start for which the bridge looks for another run, unless :attr:`Graph.alone`: participants announce
themselves once a second. The world is set up meanwhile."""
PULSE_S = 1.0  # [s] period of signs of life
HELLO_PERIOD = 0.03  # [s] period of the greetings of the handshake, to which stages reply once they are ready
RESEND_FIRST, RESEND = 0.25, 1.0  # [s] wait for answers after which step 0, or a later step, is published again
SLACK = 2.0
"""An external ego is asked again after its longest wait so far, times this, if that is more than RESEND: one that takes
long for a step would fall further behind with every repetition that it answers."""
LAST_CALL_S = 1.0
"""[s] Grace period after a timeout, except after step 0 in real time: the step is published again, and answers are
taken that arrived while the bridge itself was not scheduled, so that a pause of the machine does not end a run."""
FAREWELL_S = 10.0  # [s] time limit for the recorder to close its file


class Graph(Protocol):
    """Interface of the graph of nodes to a run."""

    @property
    def domain(self) -> str:
        """Description of the graph's domain."""

    @property
    def since(self) -> float:
        """Time of the performance counter since which this graph listens [s]."""

    @property
    def alone(self) -> bool:
        """Whether it is known without listening that there was no other run at the start."""

    def begin(self) -> None:
        """Publish the messages for the whole run."""

    def greet(self) -> None:
        """Ask all stages to report their state again."""

    def show(self, table: AgentTable) -> None:
        """Publish a step: what the stages wait for."""

    def accompany(self, table: AgentTable) -> None:
        """Publish the other messages of the last step shown: clock, state of the ego, standard types, diagnostics."""

    def show_again(self) -> None:
        """Publish the last step shown again."""

    def apply(self, command: EgoCommand) -> None:
        """Publish the command that the answer of an external ego was converted to."""

    def report_time(self, step: int, compute_time: float, marks: str) -> None:
        """Publish the compute time of the bridge for a step [s], and its marks."""

    def say(self, state: StageState, step: int, compute_time: float = 0.0, text: str = "") -> None:
        """Publish the state of the run."""

    def ask_around(self) -> None:
        """Start to listen to timings, to find out which stages have answered; not done by default as it costs time."""

    def waiting(self, step: int, text: str) -> None:
        """Report to the user and to the ego's driver what a step waits for."""

    def note(self, text: str) -> None:
        """Report the state of the run to the user; repeated texts are throttled."""

    def meet_ego(self) -> None:
        """Report publishers of an external ego that were not there at step 0, which they have answered now."""

    def silent_ego(self) -> str:
        """Text that says why an external ego has not answered the current step."""

    def serve_until(self, done: Callable[[], bool], until: float) -> bool:
        """Serve messages until `done()`, or until time `until` of the performance counter; return `done()`.

        Raises:
            RunFailed: a stage has failed.
        """

    def serve(self) -> None:
        """Serve a message, or wait for one for a short time."""


class Pace:
    """Deadlines of steps in real time, on the performance counter [s]. Lost time is not made up for.

    Attributes:
        due: deadline of the answers to the current step.
    """

    def __init__(self, step_s: float) -> None:
        """`step_s` is the wall time of a step [s]."""
        self.due, self._step_s = 0.0, step_s

    def next_step(self, now: float) -> None:
        """Begin a step: it is due a step's time after the previous one, but not before half of that has passed."""
        self.due = max(self.due + self._step_s, now + 0.5 * self._step_s)

    def restart(self, now: float) -> None:
        """Restart at `now`, as if the current step were due now."""
        self.due = now


class RunLoop:
    """One run of one scenario."""

    def __init__(
        self,
        graph: Graph,
        plan: RunPlan,
        options: BridgeOptions,
        set_up: Callable[[], World],
        port: EgoPort,
        liveness: StageLiveness,
        responses: ResponseCollector,
    ) -> None:
        """`set_up` makes the world; called while the stages get ready, or while the bridge looks for other runs."""
        self._graph, self._plan, self._options, self._set_up = graph, plan, options, set_up
        self._port, self._liveness, self._responses = port, liveness, responses
        self._external = plan.ego == EXTERNAL
        self._realtime = options.mode == "realtime"
        self._asked_around = False
        self._longest = 0.0  # [s] longest wait for an external ego since step 0
        self._compute = 0.0  # [s] compute time of the newest step
        self._reported = 0.0  # [s] compute time of the step that is reported next
        self._marks: dict[str, float] = {}  # marks of the last step shown

    def run(self) -> None:
        """Wait for all stages, run every step, and let the recorder finish.

        Raises:
            RunFailed: a stage failed or did not answer.
        """
        alone = self._graph.alone
        if alone:
            self._graph.begin()  # the stages get ready while the world is set up
        with closing(self._set_up()) as self._world:
            if not alone:
                self._graph.serve_until(lambda: False, self._graph.since + LOOK_S)
                self._graph.begin()
            self._run()

    def _run(self) -> None:
        """See :meth:`run`; after RunInfo has been published."""
        self._meet()
        last, wall = self._all_steps(self._plan.scenario.total_steps)
        if self._external:
            self._graph.meet_ego()
        if RECORDER in self._plan.stages:
            until = time.perf_counter() + self._options.answer_timeout_s
            self._graph.serve_until(lambda: self._liveness.recorded >= last, until)
            self._liveness.check_recorded(last)
        self._graph.say(StageState.FINISHED, last, wall, self._summary())
        self.farewell()
        if self._liveness.recorder_closing:
            raise RunFailed(f"{RECORDER}: no FINISHED on {STATUS} within {FAREWELL_S:g} s of the end of the run")
        self._liveness.check()

    def farewell(self) -> None:
        """Wait for the recorder to close its file."""
        until = time.monotonic() + FAREWELL_S
        while self._liveness.recorder_closing and time.monotonic() < until:
            self._graph.serve()

    def _meet(self) -> None:
        """Greet until every stage is ready."""
        liveness, begin = self._liveness, time.monotonic()
        while not liveness.all_ready:
            waiting, since = ", ".join(liveness.awaited), time.monotonic() - begin
            if since > self._options.handshake_timeout_s:
                raise RunFailed(
                    f"{waiting}: no READY for run {self._plan.run_id} on {STATUS} within "
                    f"{self._options.handshake_timeout_s:g} s; is the node running in {self._graph.domain}?"
                )
            if since > RESEND:
                self._graph.note(f"waiting for READY from {waiting} on {STATUS}")
            self._graph.greet()
            self._graph.serve_until(lambda: liveness.all_ready, time.perf_counter() + HELLO_PERIOD)

    def _all_steps(self, total: int) -> tuple[int, float]:
        """Run steps 0 to `total`, or until the ego has left.

        Returns:
            The last step, and the wall time since step 0 was answered [s].
        """
        graph, pace, start = self._graph, Pace(STEP_S / self._options.real_time_factor), 0.0
        table = self._world.reset()
        with Progress(self._options.progress, total) as progress:
            for step in range(total + 1):
                pace.next_step(time.perf_counter())
                self._wait_for_answers(table, pace.due)
                if step == 0:  # the wait for all stages at step 0 does not count
                    start = time.perf_counter()
                    pace.restart(start)
                controls, command = self._take(step)
                if self._realtime:
                    graph.serve_until(lambda: False, pace.due)
                ended = self._world.ended
                if ended is None and step < total:
                    before = time.perf_counter()
                    table = self._advance(controls, command)
                    self._compute = time.perf_counter() - before
                    self._announce_end(total)
                progress.show(step, step if ended else total)
                if ended:
                    break
        self._report_time(step)
        return step, time.perf_counter() - start

    def _announce_end(self, total: int) -> None:
        """Announce an early end if the step just made is the last, so that no node waits for more."""
        if (ended := self._world.ended) is not None and ended.step < total:
            self._graph.say(StageState.ENDING, ended.step, text=ended.sentence)

    def _wait_for_answers(self, table: AgentTable, due: float) -> None:
        """Publish a step and wait for the answers to it, in real time until `due`."""
        graph, responses, step = self._graph, self._responses, table.step
        begin = time.perf_counter()
        responses.open(table, driven=self._world.ego_is_driven)
        graph.show(table)
        shown = time.perf_counter()
        graph.accompany(table)
        if step > 0:
            self._report_time(step - 1)
        self._world.catch_up()
        self._marks = {"begin": begin, "shown": shown, "free": time.perf_counter()}
        patient = step == 0 or not self._realtime
        give_up = time.perf_counter() + self._timeout(step) if patient else due
        behind = self._port.behind if self._external else 0
        responses.ask()
        while True:
            until = min(give_up, time.perf_counter() + self._patience(step))
            if graph.serve_until(lambda: not responses.missing, until):
                self._marks.setdefault("answered", time.perf_counter())
                self._note_wait(step)
                graph.apply(responses.command())  # the recorder waits for it
                graph.serve_until(lambda: responses.complete, until)
            if patient and self._port.behind < behind:  # not silent: it still answers repetitions of the step before
                behind, give_up = self._port.behind, time.perf_counter() + self._timeout(step)
            over = time.perf_counter() >= give_up
            if responses.complete or (over and not patient):
                self._marks["complete"] = time.perf_counter()
                return
            if over:
                give_up, patient = time.perf_counter() + LAST_CALL_S, False
            self._ask_around(step)
            if over or not behind:
                responses.ask()
                graph.show_again()

    def _patience(self, step: int) -> float:
        """Wait for answers after which the step is published again [s]."""
        return RESEND_FIRST if step == 0 else max(RESEND, SLACK * self._longest)

    def _note_wait(self, step: int) -> None:
        """Note how long an external ego has taken; it may have been started late for step 0."""
        if self._external and step > 0:
            self._longest = max(self._longest, self._marks["answered"] - self._marks["shown"])

    def _ask_around(self, step: int) -> None:
        """Report missing answers; the stages repeat their timings, which show which one is silent."""
        if not self._asked_around:
            self._asked_around = True
            self._graph.ask_around()
        if step > 0 or self._external:
            waiting = self._responses.missing or [f"{RECORDED} of the recorder"]
            self._graph.waiting(step, f"waiting for {', '.join(waiting)}")

    def _report_time(self, step: int) -> None:
        """Publish the times of a step; called after the next step is published, since no node waits for them."""
        self._graph.report_time(step, self._reported, step_marks(self._marks))
        self._reported = self._compute

    def _take(self, step: int) -> tuple[ControlTable, EgoCommand]:
        """The answers to `step`; if one is missing, the newest one stays in force, or the run ends."""
        missed = self._responses.settle(self._timeout(step), lambda: self._silent(step))
        if missed:  # the recorder need not wait for them
            self._graph.say(StageState.RUNNING, step, text=f"missed {', '.join(missed)}")
        if not self._responses.commanded:
            self._graph.apply(self._responses.command())
        return self._responses.controls(), self._responses.command()

    def _advance(self, controls: ControlTable, command: EgoCommand) -> AgentTable:
        try:
            return self._world.step(controls, command)
        except ValueError as error:
            raise RunFailed(str(error)) from error

    def _timeout(self, step: int) -> float:
        """Time limit for the answers to a step [s]; at step 0 that of an external ego."""
        if step > 0:
            return self._options.answer_timeout_s
        return self._options.external_timeout_s if self._external else self._options.handshake_timeout_s

    def _silent(self, step: int) -> str:
        """Text that names the stages that have not answered `step`, as far as known."""
        silent = self._liveness.silent(step, self._responses.missing)
        if self._external and self._port.missing:
            silent.append(f"the external ego ({self._graph.silent_ego()})")
        return f"; silent: {', '.join(silent)}" if silent else ""

    def _summary(self) -> str:
        """Summary of the run by the bridge, in YAML, for the recording."""
        return yaml.safe_dump(self._responses.summary() | self._world.summary(), sort_keys=False)


class Pulse:
    """Signs of life for the launcher, on standard output; also printed while a run waits."""

    def __init__(self, wanted: bool) -> None:
        self._wanted, self._last = wanted, -math.inf

    def beat(self, step: int) -> None:
        """Print one unless one was printed recently; `step` is the current one."""
        if self._wanted and time.monotonic() >= self._last + PULSE_S:
            self._last = time.monotonic()
            print(f"alive at step {max(0, step)}", flush=True)

    def note(self, text: str) -> None:
        """Print what the run has been waiting for, for the user."""
        if self._wanted:
            print(f"note {text}", flush=True)

    def fail(self) -> None:
        """Print when the run has failed, before the stages learn of it: the launcher then knows why they end."""
        if self._wanted:
            print(f"failed at {time.monotonic()} s", flush=True)


class Progress:
    """Progress of a run: a `bar` on a terminal, `lines` for the launcher, or `none`."""

    def __init__(self, kind: str, total: int) -> None:
        self._lines = kind == "lines"
        self._bar = tqdm(total=total, unit="step", disable=kind != "bar")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def show(self, step: int, last: int) -> None:
        """Show that `step` is answered; `last` is the last step as far as known."""
        self._bar.update(step > 0)
        if self._lines and (step % 10 == 0 or step == last):
            print(f"step {step} of {last}", flush=True)
