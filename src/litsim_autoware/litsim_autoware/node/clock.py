"""The stack's time on /clock: before the run, while the stack gets ready, and then from step to step."""

from __future__ import annotations

import time

from rclpy.node import Node

from litsim_autoware.messages.cdr import TIME, Message, stamped
from litsim_autoware.messages.output import Output
from litsim_autoware.stack.timeline import BEGIN_NS, Timeline
from litsim_sim.nodes.step_clock import TICK_NS, StepClock
from litsim_sim.ros.topics import CLOCK

CLOCK_MESSAGE = Message(*TIME)


class StackClock:
    """Publishes the stack's time if anybody listens but the recorder, which has no use of it.

    Attributes:
        ticks: of :data:`TICK_NS`, since the clock began; they pass until the run is released.
        timeline: the stack's time of each step.
        steps: publishes the time from the release on.
    """

    steps: StepClock

    def __init__(self, node: Node) -> None:
        self._output = Output(node, CLOCK.type, CLOCK.name, CLOCK.qos)
        self._begin = time.perf_counter()
        self.ticks, self.timeline = 0, Timeline()

    @property
    def is_released(self) -> bool:
        """Whether the run has begun."""
        return self.timeline.start_ns is not None

    @property
    def waiting_ns(self) -> int:
        """Time of the newest tick before the run [ns]."""
        return BEGIN_NS + self.ticks * TICK_NS

    def is_heard(self) -> bool:
        """Returns whether anybody listens but the recorder."""
        return self._output.listeners > 1

    def wait(self, now: float) -> bool:
        """Let time pass before the run, until `now` of the performance counter [s]; return whether there was a tick."""
        ticks = int((now - self._begin) * 1e9 / TICK_NS)
        if ticks <= self.ticks:
            return False
        self.ticks = ticks
        self._show(self.waiting_ns)
        return True

    def until_tick(self, now: float) -> float:
        """Returns the time from `now` of the performance counter until the next tick before the run [s]."""
        return self._begin + (self.ticks + 1) * TICK_NS * 1e-9 - now

    def release(self, factor: float) -> None:
        """Begin the run, `factor` times as fast as the wall clock: publish the ticks that are left until step 0."""
        self.timeline.release(self.waiting_ns)
        start_ns = self.timeline.stamp(0)
        for time_ns in range(self.waiting_ns + TICK_NS, start_ns, TICK_NS):
            self._show(time_ns)
        self.steps = StepClock(lambda time_ns: self._show(start_ns + time_ns), self.is_heard, factor)

    def _show(self, time_ns: int) -> None:
        if self.is_heard():
            self._output.publish(lambda: CLOCK_MESSAGE.data(stamped(time_ns)))
