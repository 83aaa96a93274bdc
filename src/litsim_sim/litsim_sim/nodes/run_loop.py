"""The course of a run: handshake, steps, farewell. Without ROS.

Messages are exchanged through :class:`litsim_sim.nodes.bridge.BridgeNode`.
"""

from __future__ import annotations

import math
import time
from contextlib import closing
from typing import TYPE_CHECKING

from tqdm import tqdm

from litsim_sim.core.scene import STEP_S, AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import RECORDER, StageState
from litsim_sim.core.step_marks import step_marks
from litsim_sim.core.topic_names import RECORDED, STATUS
from litsim_sim.nodes.responses import RunFailed
from litsim_sim.scenario.run_info import EXTERNAL

if TYPE_CHECKING:
    from litsim_sim.nodes.bridge import BridgeNode

LOOK_S = 1.0
"""[s] Time from its start for which the bridge looks for another run, unless it is known to be alone: participants
announce themselves once a second. The world is set up meanwhile."""
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


class RunLoop:
    """One run of one scenario."""

    def __init__(self, bridge: BridgeNode) -> None:
        self._bridge, self._plan, self._options = bridge, bridge.plan, bridge.options
        self._port, self._liveness, self._responses = bridge.port, bridge.liveness, bridge.responses
        self._external = bridge.plan.ego == EXTERNAL
        self._realtime = bridge.options.mode == "realtime"
        self._reported_missing = False
        self._longest = 0.0  # [s] longest wait for an external ego since step 0
        self._compute = 0.0  # [s] compute time of the newest step
        self._reported = 0.0  # [s] compute time of the step that is reported next
        self._marks: dict[str, float] = {}  # marks of the last step shown

    def run(self) -> None:
        """Wait for all stages, run every step, and let the recorder finish; raises RunFailed if one does not answer."""
        alone = self._bridge.alone
        if alone:
            self._bridge.begin()  # the stages get ready while the world is set up
        with closing(self._bridge.set_up()) as self._world:
            if not alone:
                self._bridge.serve_until(lambda: False, self._bridge.since + LOOK_S)
                self._bridge.begin()
            self._run()

    def _run(self) -> None:
        """See :meth:`run`; after RunInfo has been published."""
        self._handshake()
        self._bridge.check_publishers()
        last, wall = self._all_steps(self._plan.scenario.total_steps)
        self._bridge.check_publishers()
        if self._external:
            self._bridge.note_ego_publishers()
        until = time.perf_counter() + self._options.answer_timeout_s
        self._bridge.serve_until(lambda: self._liveness.recorded >= last, until)
        self._liveness.check_recorded(last)
        summary = self._responses.summary() | self._world.summary()
        self._bridge.finish(last, wall, summary)
        self.farewell()
        if self._liveness.recorder_closing:
            raise RunFailed(f"{RECORDER}: no FINISHED on {STATUS} within {FAREWELL_S:g} s of the end of the run")
        self._liveness.check()

    def farewell(self) -> None:
        """Wait for the recorder to close its file."""
        until = time.monotonic() + FAREWELL_S
        while self._liveness.recorder_closing and time.monotonic() < until:
            self._bridge.serve()

    def _handshake(self) -> None:
        """Greet until every stage is ready."""
        liveness, begin = self._liveness, time.monotonic()
        while not liveness.all_ready:
            waiting, since = ", ".join(liveness.awaited), time.monotonic() - begin
            if since > self._options.handshake_timeout_s:
                raise RunFailed(
                    f"{waiting}: no READY for run {self._plan.run_id} on {STATUS} within "
                    f"{self._options.handshake_timeout_s:g} s; is the node running in {self._bridge.domain}?"
                )
            if since > RESEND:
                self._bridge.note(f"waiting for READY from {waiting} on {STATUS}")
            self._bridge.greet()
            self._bridge.serve_until(lambda: liveness.all_ready, time.perf_counter() + HELLO_PERIOD)

    def _all_steps(self, total: int) -> tuple[int, float]:
        """Run steps 0 to `total`, or until the ego left; return the last one, and the wall time since step 0 [s]."""
        bridge = self._bridge
        step_s = STEP_S / self._options.real_time_factor  # wall time of a step in real time [s]
        due = start = 0.0  # in real time, the step is due then [s]; lost time is not made up for
        table = self._world.reset()
        with tqdm(total=total, unit="step", disable=self._options.progress != "bar") as bar:
            for step in range(total + 1):
                due = max(due + step_s, time.perf_counter() + 0.5 * step_s)
                self._wait_for_answers(table, due)
                if step == 0:  # the wait for all stages at step 0 does not count
                    due = start = time.perf_counter()
                controls, command = self._take(step)
                if self._realtime:
                    bridge.serve_until(lambda: False, due)
                ended = self._world.ended
                if ended is None and step < total:
                    bridge.hold()
                    before = time.perf_counter()
                    table = self._advance(controls, command)
                    self._compute = time.perf_counter() - before
                    if (early := self._world.ended) is not None and early.step < total:
                        bridge.say(StageState.ENDING, early.step, text=early.sentence)  # so no node waits for more
                bar.update(step > 0)
                if ended or step % 10 == 0 or step == total:
                    bridge.pulse.say("step", f"{step} of {step if ended else total}")
                if ended:
                    break
        self._report_time(step)
        return step, time.perf_counter() - start

    def _wait_for_answers(self, table: AgentTable, due: float) -> None:
        """Publish a step and wait for the answers to it, in real time until `due`."""
        bridge, responses, step = self._bridge, self._responses, table.step
        begin = time.perf_counter()
        responses.open(table, driven=self._world.ego_is_driven)
        bridge.show(table)
        shown = time.perf_counter()
        bridge.accompany(table)
        if step > 0:
            self._report_time(step - 1)
        self._world.catch_up()
        self._marks = {"begin": begin, "shown": shown, "free": time.perf_counter()}
        patient = step == 0 or not self._realtime
        give_up = time.perf_counter() + self._timeout(step) if patient else due
        behind = self._port.behind if self._external else 0
        responses.ask()
        while True:
            patience = RESEND_FIRST if step == 0 else max(RESEND, SLACK * self._longest)
            until = min(give_up, time.perf_counter() + patience)
            if bridge.serve_until(lambda: not responses.missing, until):
                self._marks.setdefault("answered", time.perf_counter())
                if self._external and step > 0:  # it may have been started late for step 0
                    self._longest = max(self._longest, self._marks["answered"] - shown)
                bridge.apply(responses.command())  # the recorder waits for it
                bridge.serve_until(lambda: responses.complete, until)
            if patient and self._port.behind < behind:  # not silent: it still answers repetitions of the step before
                behind, give_up = self._port.behind, time.perf_counter() + self._timeout(step)
            over = time.perf_counter() >= give_up
            if responses.complete or (over and not patient):
                self._marks["complete"] = time.perf_counter()
                return
            if over:
                give_up, patient = time.perf_counter() + LAST_CALL_S, False
            self._report_missing(step)
            if over or not behind:
                responses.ask()
                bridge.show_again()

    def _report_missing(self, step: int) -> None:
        """Report missing answers; the stages repeat their timings, which show which one is silent."""
        if not self._reported_missing:
            self._reported_missing = True
            self._bridge.listen_to_timings()
        if step > 0 or self._external:
            waiting = self._responses.missing or [f"{RECORDED} of the recorder"]
            self._bridge.waiting(step, f"waiting for {', '.join(waiting)}")

    def _report_time(self, step: int) -> None:
        """Publish the times of a step; called after the next step is published, since no node waits for them."""
        self._bridge.report_time(step, self._reported, step_marks(self._marks | self._bridge.watch_marks))
        self._bridge.watch_marks = {}
        self._reported = self._compute

    def _take(self, step: int) -> tuple[ControlTable, EgoCommand]:
        """Returns the answers to `step`; if one is missing, the newest one stays in force, or the run ends."""
        missed = self._responses.settle(self._timeout(step), lambda: self._silent(step))
        if missed:  # the recorder need not wait for them
            self._bridge.say(StageState.RUNNING, step, text=f"missed {', '.join(missed)}")
        if not self._responses.commanded:
            self._bridge.apply(self._responses.command())
        return self._responses.controls(), self._responses.command()

    def _advance(self, controls: ControlTable, command: EgoCommand) -> AgentTable:
        try:
            return self._world.step(controls, command)
        except ValueError as error:
            raise RunFailed(str(error)) from error

    def _timeout(self, step: int) -> float:
        """Returns the time limit for the answers to a step [s]; at step 0 that of an external ego."""
        if step > 0:
            return self._options.answer_timeout_s
        return self._options.external_timeout_s if self._external else self._options.handshake_timeout_s

    def _silent(self, step: int) -> str:
        """Returns a text that names the stages that have not answered `step`, as far as known."""
        silent = self._liveness.silent(step, self._responses.missing)
        if self._external and self._port.missing:
            silent.append(f"the external ego ({self._bridge.silent_ego()})")
        return f"; silent: {', '.join(silent)}" if silent else ""


class Pulse:
    """Lines for the launcher on standard output: signs of life, also while a run waits, and what it is to know."""

    def __init__(self, wanted: bool) -> None:
        self._wanted, self._last = wanted, -math.inf

    def beat(self, step: int) -> None:
        """Print a sign of life unless one was printed recently; `step` is the current one."""
        if time.monotonic() >= self._last + PULSE_S:
            self._last = time.monotonic()
            self.say("alive", f"at step {max(0, step)}")

    def say(self, word: str, text: str) -> None:
        """Print a line, as :class:`litsim_sim.launch.processes.Progress` reads it by its first `word`."""
        if self._wanted:
            print(word, text, flush=True)
