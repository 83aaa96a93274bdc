"""The adapter's node: takes each step of the bridge, and has it published for Autoware and answered."""

from __future__ import annotations

import time
from math import inf

import numpy as np
from litsim_msgs.msg import AgentStates, JointForecast, RunInfo, SignalStates, StageStatus
from rclpy.node import Node

from litsim_autoware.node.announced_run import AnnouncedRun
from litsim_autoware.node.answers import Answers
from litsim_autoware.node.clock import StackClock
from litsim_autoware.node.ego_feed import STATE_S, EgoFeed
from litsim_autoware.node.preparation import Preparation
from litsim_autoware.node.surroundings import Surroundings, forecast_of
from litsim_autoware.node.vehicle_state import VehicleState
from litsim_autoware.stack.profile import Profile
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.core.stages import BRIDGE, StageState
from litsim_sim.nodes.step_clock import TICK_NS
from litsim_sim.ros.endpoints import subscribe
from litsim_sim.ros.topics import AGENTS, FORECASTS, RUN_INFO, SIGNALS, STATUS

NODE = "litsim_autoware"
STATE_TICKS = round(STATE_S * 1e9 / TICK_NS)
OBJECTS_TICKS = 5 * STATE_TICKS  # period of the objects before the run


class AutowareNode(Node):
    """Answers every step of a run with what Autoware commands.

    Attributes:
        finished: whether the run is over.
    """

    def __init__(self, profile: Profile) -> None:
        """Make the node."""
        super().__init__(NODE)
        self.finished = False
        self._run: AnnouncedRun | None = None
        self._table: AgentTable | None = None
        self._shown = -1  # newest step that was published
        self._compute_s: list[float] = []  # of each step, from its agents to the ego's pose
        self._cpu_s: list[float] = []  # of which this thread has used
        self._clock = StackClock(self)
        self._state = VehicleState(self, profile)
        self._ego = EgoFeed(self, self._state)
        self._surroundings = Surroundings(self, profile)
        self._answers = Answers(self, profile, self._clock, self._ego)
        self._preparation = Preparation(self, profile, self._clock)
        subscribe(self, RUN_INFO, self._on_run_info)
        subscribe(self, AGENTS, self._on_agents)
        subscribe(self, SIGNALS, self._on_signals)
        subscribe(self, FORECASTS, self._on_forecast)
        subscribe(self, STATUS, self._on_status)

    def tick(self, now: float) -> float:
        """Publish what is due at `now` of the performance counter [s]; return the time until the next call is due."""
        if self._run is None or self._table is None:
            return inf
        if not self._clock.is_released:
            if self._clock.wait(now):
                self._prepare(self._run, self._table, now)
            return self._clock.until_tick(now)
        wait = self._clock.steps.tick(now)
        if wait == inf and self._clock.is_heard():  # no time is left for timers of the stack
            self._answers.respond_early()
        return min(wait, self._ego.show_between_steps(now)) if self._run.is_realtime else wait

    def _prepare(self, run: AnnouncedRun, table: AgentTable, now: float) -> None:
        """Show the scene, which stands still, until the stack is ready, and then begin the run."""
        self._show_standing(run, table)
        was_ready = self._preparation.is_done
        self._preparation.poll(now)
        self._answers.is_heard &= was_ready
        if not (self._preparation.is_done and self._answers.is_heard):
            self._preparation.note()
            return
        self._clock.release(run.time_factor)
        start_s = self._clock.timeline.stamp(0) * 1e-9
        self.get_logger().info(f"the stack drives; step 0 is at {start_s:.1f} s of its time")
        self._show_step(run, table)

    def _show_standing(self, run: AnnouncedRun, table: AgentTable) -> None:
        """Publish the scene at rest, if it is due at this tick."""
        motion = run.rear_axle(table)
        if self._clock.ticks % STATE_TICKS or motion is None:
            return
        if self._clock.ticks % OBJECTS_TICKS == 0:
            others = table.take(table.id != run.ego_id)
            zeros = np.zeros(len(others))
            others.speed, others.acceleration, others.yaw_rate = zeros, zeros, zeros
            self._surroundings.show(others, self._clock.waiting_ns)
        self._ego.show(motion.at_rest(), self._clock.waiting_ns)

    def _show_if_complete(self, begin: float, *, patient: bool = True) -> None:
        """Publish the newest step once all of it is here; unless `patient`, without what is missing of forecasts."""
        run, table = self._run, self._table
        if run is None or table is None or not self._clock.is_released or table.step == self._answers.answered:
            return
        if patient and table.step == self._shown:
            return
        if not self._surroundings.is_complete(table.step, with_forecast=patient and not run.is_realtime):
            return
        cpu = time.thread_time()
        self._show_step(run, table)
        self._compute_s.append(time.perf_counter() - begin)
        self._cpu_s.append(time.thread_time() - cpu)

    def _show_step(self, run: AnnouncedRun, table: AgentTable) -> None:
        """Publish a step; the ego's pose last, so that whoever answers it has the rest."""
        began, stamp_ns, motion = time.perf_counter(), self._clock.timeline.stamp(table.step), run.rear_axle(table)
        self._shown = table.step
        self._clock.steps.step(table.step, began)
        self._ego.begin_step(motion, stamp_ns, began)
        self._surroundings.show(run.others(table), stamp_ns)
        if motion is None:  # it has left, and this is the last step
            self._answers.respond(EgoCommand(table.step))
            return
        self._ego.show_step(motion, run.geometry.wheelbase)
        self._state.tell(table.step)

    def _on_run_info(self, info: RunInfo) -> None:
        if self._run is not None:
            return
        run = self._run = AnnouncedRun.of(info)
        self._surroundings.begin_run(run)
        self._answers.begin_run(run)
        self._preparation.begin_run(run, lambda: run.rear_axle(self._table) if self._table else None)
        self._ego.begin_run(run.geometry)

    def _on_agents(self, message: AgentStates) -> None:
        if not self._is_of_run(message.run_id):
            return
        begin = time.perf_counter()
        again = message.step == self._answers.newest
        if again and message.step == self._answers.answered:
            self._answers.repeat()  # the bridge asks again
            return
        if again:
            self._answers.respond_early()
        self._table, self._answers.newest = AgentTable.of_message(message), message.step
        self._show_if_complete(begin, patient=not again)

    def _on_signals(self, message: SignalStates) -> None:
        if self._is_of_run(message.run_id):
            self._surroundings.signals = message
            self._show_if_complete(time.perf_counter())

    def _on_forecast(self, message: JointForecast) -> None:
        if self._is_of_run(message.run_id) and self._surroundings.with_forecasts:
            self._surroundings.forecasts.append(forecast_of(message))
            self._show_if_complete(time.perf_counter())

    def _on_status(self, status: StageStatus) -> None:
        ended = status.stage == BRIDGE and status.state in (StageState.FINISHED, StageState.FAILED)
        if ended and self._is_of_run(status.run_id):
            self.finished = True
            if self._compute_s:
                wall, cpu = (1e3 * float(np.median(times)) for times in (self._compute_s, self._cpu_s))
                self.get_logger().info(
                    f"{len(self._compute_s) + 1} steps, each published in {wall:.2f} ms (median), {cpu:.2f} ms of CPU"
                )

    def _is_of_run(self, run_id: str) -> bool:
        """Returns whether a message is of the run that was announced."""
        return self._run is not None and self._run.run_id == run_id
