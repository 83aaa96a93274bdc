"""The bridge of a run: steps the simulation by the answers that the nodes of the graph give to each step."""

from __future__ import annotations

import sys
import time
from contextlib import closing

from tqdm import tqdm

from litsim_sim.core.errors import EXIT_FAILED, print_error, reason
from litsim_sim.core.lockstep import step_marks
from litsim_sim.core.scene import STEP_S, AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import RECORDER, StageState
from litsim_sim.core.topic_names import RECORDED, STATUS
from litsim_sim.launch.domain import held_domain
from litsim_sim.nodes.bridge_node import BridgeNode
from litsim_sim.nodes.responses import RunFailed
from litsim_sim.record.digest import RunDigest
from litsim_sim.record.seal import RunFacts
from litsim_sim.ros.process import process, spare_from_collection
from litsim_sim.scenario.policies import REPLAY
from litsim_sim.scenario.run_info import EXTERNAL
from litsim_sim.simulation import Simulation

LOOK_S = 1.0
"""[s] Time from its start for which the bridge looks for another run, unless it is known to be alone: participants
announce themselves once a second. The simulation is set up meanwhile."""
HELLO_PERIOD = 0.03  # [s] period of the greetings of the handshake, to which stages reply once they are ready
RESEND_FIRST, RESEND = 0.25, 1.0  # [s] wait for answers after which step 0, or a later step, is published again
SLACK = 2.0
"""An external ego is asked again after its longest wait so far, times this, if that is more than RESEND: one that takes
long for a step would fall further behind with every repetition that it answers."""
LAST_CALL_S = 1.0
"""[s] Grace period after a timeout, except after step 0 in real time: the step is published again, and answers are
taken that arrived while the bridge itself was not scheduled, so that a pause of the machine does not end a run."""
FAREWELL_S = 10.0  # [s] time limit for the recorder to close its file


class Bridge:
    """One run: a :class:`.Simulation` whose stages are nodes, which answer through a :class:`.BridgeNode`.

    Attributes:
        over: whether all steps are answered.
        facts: what the run came to, for its seal; None before its end.
    """

    def __init__(self, node: BridgeNode) -> None:
        self.over = False
        self.facts: RunFacts | None = None
        self._digest = RunDigest()
        self._undigested: tuple[AgentTable, ControlTable | None, EgoCommand] | None = None
        self._node, self._plan, self._options = node, node.plan, node.options
        self._port, self._liveness, self._responses = node.port, node.liveness, node.responses
        self._external = node.plan.ego == EXTERNAL
        self._realtime = node.options.mode == "realtime"
        self._reported_missing = False
        self._longest = 0.0  # [s] longest wait for an external ego since step 0
        self._compute = 0.0  # [s] compute time of the newest step
        self._reported = 0.0  # [s] compute time of the step that is reported next
        self._marks: dict[str, float] = {}  # marks of the last step shown

    def run(self) -> None:
        """Run to the end of the record; raises RunFailed, of which all stages are told, if one does not answer."""
        try:
            self._run()
        except BaseException as error:
            text = str(error) if isinstance(error, RunFailed) else reason(error)
            self._node.pulse.say("failed", f"at {time.monotonic()} s")  # before the stages learn of it and end
            self._node.say(StageState.FAILED, self._responses.step, text=text)
            self._farewell()
            raise
        finally:
            self._node.end_services()

    def _run(self) -> None:
        """Wait for all stages, run every step, and let the recorder finish."""
        node = self._node
        if node.alone:
            node.begin()  # the stages get ready while the simulation is set up
        self._simulation = self._set_up()
        with closing(self._simulation.world):
            if not node.alone:
                node.serve_until(lambda: False, node.since + LOOK_S)
                node.begin()
            self._handshake()
            node.check_publishers()
            wall = self._all_steps()
            self.over = True
            node.check_publishers()
            if self._external:
                node.note_ego_publishers()
            self._conclude(wall)

    def _set_up(self) -> Simulation:
        """Returns the simulation of the run, with its mirror and kernels."""
        from litsim_sim.world.sumo import SumoMirror  # imported here so that the stages know of the run first

        scenario = self._plan.scenario
        policy = REPLAY if self._plan.policy == REPLAY else None
        mirror = SumoMirror(scenario.net_path, scenario.seed, scenario.signals)
        simulation = Simulation(scenario, policy=policy, mirror=mirror)
        spare_from_collection()
        return simulation

    def _conclude(self, wall: float) -> None:
        """Wait for the record of all steps, which took `wall` seconds, and report their summary."""
        last, (summary,) = self._simulation.table.step, self._simulation.summaries.values()
        until = time.perf_counter() + self._options.answer_timeout_s
        self._node.serve_until(lambda: self._liveness.recorded >= last, until)
        self._liveness.check_recorded(last)
        self.facts = self._node.finish(last, wall, self._responses.summary() | summary, self._digest.hexdigest())
        self._farewell()
        if self._liveness.recorder_closing:
            raise RunFailed(f"{RECORDER}: no FINISHED on {STATUS} within {FAREWELL_S:g} s of the end of the run")
        self._liveness.check()
        self._node.pulse.say("facts", self.facts.text)

    def _farewell(self) -> None:
        """Wait for the recorder to close its file."""
        until = time.monotonic() + FAREWELL_S
        while self._liveness.recorder_closing and time.monotonic() < until:
            self._node.serve()

    def _handshake(self) -> None:
        """Greet until every stage is ready."""
        liveness, begin = self._liveness, time.monotonic()
        while not liveness.all_ready:
            waiting, since = ", ".join(liveness.awaited), time.monotonic() - begin
            if since > self._options.handshake_timeout_s:
                raise RunFailed(
                    f"{waiting}: no READY for run {self._plan.run_id} on {STATUS} within "
                    f"{self._options.handshake_timeout_s:g} s; is the node running in {self._node.domain}?"
                )
            if since > RESEND:
                self._node.note(f"waiting for READY from {waiting} on {STATUS}")
            self._node.greet()
            self._node.serve_until(lambda: liveness.all_ready, time.perf_counter() + HELLO_PERIOD)

    def _all_steps(self) -> float:
        """Run all steps; return the wall time since step 0 [s]."""
        node, simulation, total = self._node, self._simulation, self._plan.scenario.total_steps
        step_s = STEP_S / self._options.real_time_factor  # wall time of a step in real time [s]
        due = start = 0.0  # in real time, the step is due then [s]; lost time is not made up for
        with tqdm(total=total, unit="step", disable=self._options.progress != "bar") as bar:
            while not simulation.ended:
                step = simulation.table.step
                if step > 0:
                    node.hold()
                due = max(due + step_s, time.perf_counter() + 0.5 * step_s)
                self._wait_for_answers(due)
                if step == 0:  # the wait for all stages at step 0 does not count
                    due = start = time.perf_counter()
                command, controls = self._take(step)
                if self._realtime:
                    node.serve_until(lambda: False, due)
                self._advance(command, controls)
                bar.update(step > 0)
                if simulation.ended or step % 10 == 0:
                    node.pulse.say("step", f"{step} of {step if simulation.ended else total}")
        self._report_time(step)
        wall = time.perf_counter() - start
        self._digest_answered()
        return wall

    def _wait_for_answers(self, due: float) -> None:
        """Publish the present step and wait for the answers to it, in real time until `due`."""
        node, responses, table = self._node, self._responses, self._simulation.table
        step, begin = table.step, time.perf_counter()
        responses.open(table, driven=self._simulation.world.ego_is_driven or self._options.open_loop)
        node.show(table)
        shown = time.perf_counter()
        node.accompany(table)
        if step > 0:
            self._report_time(step - 1)
        self._digest_answered()
        self._simulation.world.catch_up()
        self._marks = {"begin": begin, "shown": shown, "free": time.perf_counter()}
        patient = step == 0 or not self._realtime
        give_up = time.perf_counter() + self._timeout(step) if patient else due
        behind = self._port.behind if self._external else 0
        responses.ask()
        while True:
            patience = RESEND_FIRST if step == 0 else max(RESEND, SLACK * self._longest)
            until = min(give_up, time.perf_counter() + patience)
            if node.serve_until(self._is_answered, until):
                self._marks.setdefault("answered", time.perf_counter())
                if self._external and step > 0:  # it may have been started late for step 0
                    self._longest = max(self._longest, self._marks["answered"] - shown)
                node.apply(responses.command())  # the recorder waits for it
                node.serve_until(lambda: responses.complete, until)
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
                node.show_again()

    def _is_answered(self) -> bool:
        """Returns whether all answers to the present step are there; marks when that of the ego is."""
        if not self._port.missing:
            self._marks.setdefault("ego", time.perf_counter())
        return not self._responses.missing

    def _report_missing(self, step: int) -> None:
        """Report missing answers; the stages repeat their timings, which show which one is silent."""
        if not self._reported_missing:
            self._reported_missing = True
            self._node.listen_to_timings()
        if step > 0 or self._external:
            waiting = self._responses.missing or [f"{RECORDED} of the recorder"]
            self._node.waiting(step, f"waiting for {', '.join(waiting)}")

    def _report_time(self, step: int) -> None:
        """Publish the times of a step; called after the next step is published, since no node waits for them."""
        self._node.report_time(step, self._reported, step_marks(self._marks | self._node.watch_marks))
        self._node.watch_marks = {}
        self._reported = self._compute

    def _take(self, step: int) -> tuple[EgoCommand, ControlTable | None]:
        """Returns the answers to `step`; if one is missing, the newest one stays in force, or the run ends."""
        missed = self._responses.settle(self._timeout(step), lambda: self._silent(step))
        if missed:  # the recorder need not wait for them
            self._node.say(StageState.RUNNING, step, text=f"missed {', '.join(missed)}")
        if not self._responses.commanded:
            self._node.apply(self._responses.command())
        return self._responses.command(), None if self._plan.policy == REPLAY else self._responses.controls()

    def _advance(self, command: EgoCommand, controls: ControlTable | None) -> None:
        """Go on to the next step; if it ends the run early, tell the stages, so that no node waits for more."""
        simulation, begin = self._simulation, time.perf_counter()
        self._undigested = simulation.table, controls, command
        try:
            simulation.step(command, controls)
        except ValueError as error:
            raise RunFailed(str(error)) from error
        self._compute = time.perf_counter() - begin
        early = simulation.world.ended
        if early is not None and not simulation.ended and early.step < self._plan.scenario.total_steps:
            self._node.say(StageState.ENDING, early.step, text=early.sentence)

    def _digest_answered(self) -> None:
        """Add the step that was answered last to the digest, while others work on the next one."""
        if self._undigested is not None:
            self._digest.update(*self._undigested)
            self._undigested = None

    def _timeout(self, step: int) -> float:
        """Returns the time limit for the answers to a step [s]; at step 0 that of an external ego."""
        if step > 0:
            return self._options.answer_timeout_s
        return self._options.external_timeout_s if self._external else self._options.handshake_timeout_s

    def _silent(self, step: int) -> str:
        """Returns a text that names the stages that have not answered `step`, as far as known."""
        silent = self._liveness.silent(step, self._responses.missing)
        if self._external and self._port.missing:
            silent.append(f"the external ego ({self._node.silent_ego()})")
        return f"; silent: {', '.join(silent)}" if silent else ""


def main() -> None:
    """Entry point of ``ros2 run litsim_sim bridge``."""
    with process():
        try:
            node = BridgeNode()
            with held_domain(node.context.get_domain_id()):
                Bridge(node).run()
        except RunFailed as error:
            print_error(error)
            sys.exit(EXIT_FAILED)
