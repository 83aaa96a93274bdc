"""Simulation time of the stack: it passes before step 0, while the stack gets ready, and steps begin when it is.

Stacks need a clock that runs, and states that are fresh, to start up; the ego port waits for them at step 0. So the
stack's time is that of the run plus a constant, which is decided when the run is released.
"""

from __future__ import annotations

from litsim_sim.core.scene import STEP_NS

BEGIN_NS = 10 * 10**9
"""[ns] Time at which the stack's clock begins: zero means "no time yet" to ROS."""
TOLERANCE_NS = 1_000_000  # [ns] by which a stamp may miss its step, as by rounding of floating-point seconds


class Timeline:
    """The stack's time of each step.

    Attributes:
        start_ns: that of step 0 [ns]; None before the run is released.
    """

    def __init__(self) -> None:
        self.start_ns: int | None = None

    def release(self, now_ns: int) -> None:
        """Let step 0 be at the next whole tenth of a second after the stack's time `now_ns`."""
        self.start_ns = (now_ns // STEP_NS + 1) * STEP_NS

    def stamp(self, step: int) -> int:
        """Time of a step of a run that has been released [ns]."""
        assert self.start_ns is not None
        return self.start_ns + step * STEP_NS

    def step_of(self, stamp_ns: int) -> int:
        """The step at or before a stamp [ns]; -1 before step 0."""
        if self.start_ns is None:
            return -1
        return max(-1, (stamp_ns + TOLERANCE_NS - self.start_ns) // STEP_NS)
