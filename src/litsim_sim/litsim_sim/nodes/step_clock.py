"""Simulation time between steps, for stacks whose timers run on it. Without ROS."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

from litsim_sim.core.scene import STEP_NS

TICK_NS = 10_000_000
"""[ns] Time between two ticks while a step waits."""
COARSE_NS = 20_000_000
"""[ns] Longest time between two ticks: those that there was no time for are published at this distance."""


class StepClock:
    """Publishes the time of every step and, if others than the recorder listen, ticks between steps.

    Time never goes back, and never passes that of the next step. While step 0 waits for a stack to start, whose timers
    would not run any more once time had reached step 1, :meth:`creep` stands in for :meth:`tick`.

    Attributes:
        current: the current step.
    """

    def __init__(self, publish: Callable[[int], None], is_heard: Callable[[], bool], factor: float) -> None:
        """Make a clock that calls `publish` with times [ns]; it ticks while it `is_heard`, `factor` times as fast."""
        self._publish, self._is_heard, self._factor = publish, is_heard, factor
        self._time = 0  # [ns] last published
        self._begin = 0.0  # [s] of the performance counter, of the current step
        self.current = 0

    def step(self, step: int, now: float) -> None:
        """Begin a step at time `now` of the performance counter [s]: publish the ticks that are left, and its time."""
        if self._is_heard():
            self._fill(step * STEP_NS)
        self.current, self._begin = step, now
        self._show(step * STEP_NS)

    def finish(self) -> None:
        """Publish the ticks that are left of the current step, once it is answered and nobody waits for them."""
        if self._is_heard():
            self._fill(self._end)

    def repeat(self) -> None:
        """Publish the current time again, for subscribers that have come since."""
        self._publish(self._time)

    def creep(self) -> None:
        """Advance by one tick."""
        self._show(min(self._time + TICK_NS, self._end))

    def tick(self, now: float) -> float:
        """Publish the newest tick that is due; return the wall time until the next one [s], infinite if there is none.

        `now` is the time of the performance counter [s].
        """
        if self._time >= self._end or not self._is_heard():
            return inf
        ticks = int((now - self._begin) * self._factor * 1e9) // TICK_NS
        time_ns = min(self.current * STEP_NS + ticks * TICK_NS, self._end)
        if time_ns > self._time:
            self._fill(time_ns)
            self._show(time_ns)
        return self._begin + (self._time + TICK_NS - self.current * STEP_NS) * 1e-9 / self._factor - now

    @property
    def _end(self) -> int:
        """Time of the next step [ns]."""
        return (self.current + 1) * STEP_NS

    def _fill(self, until_ns: int) -> None:
        for time_ns in range(self._time + COARSE_NS, until_ns, COARSE_NS):
            self._show(time_ns)

    def _show(self, time_ns: int) -> None:
        self._time = time_ns
        self._publish(time_ns)
