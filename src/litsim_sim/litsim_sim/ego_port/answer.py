"""One answer of a driving system on the ego port, of any type, and the check of it by itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from math import isfinite

import numpy as np

from litsim_sim.core.errors import shown
from litsim_sim.core.scene import STEP_NS, EgoCommand
from litsim_sim.core.topic_names import Interface
from litsim_sim.ego_port.tracking import Trajectory, TwistTarget

MAP_FRAME = "map"
BODY_FRAMES = ("", "ego", "base_link")
STAMP_TOLERANCE_NS = 1_000_000  # [ns] by which a stamp may miss its step, as by rounding of floating-point seconds


@dataclass(frozen=True)
class Answer:
    """One message of a driving system.

    Attributes:
        interface: its kind.
        target: what it asks for; None if the message makes no sense, and `fault` says why.
        stamp_ns: stamp of its header [ns]; it answers the step at that time, unless `step` is given.
        step: step that it answers, for types that have it.
        run_id: run that it belongs to, for types that have it.
        frame: frame of its header, and those of its poses that differ from it.
        fault: fault found at its conversion; empty for none.
    """

    interface: Interface
    target: EgoCommand | TwistTarget | Trajectory | None
    stamp_ns: int = 0
    step: int | None = None
    run_id: str | None = None
    frame: str = MAP_FRAME
    fault: str = ""

    @property
    def nearest_step(self) -> int:
        """The step given by `step`, or that nearest to its stamp."""
        return round(self.stamp_ns / STEP_NS) if self.step is None else self.step

    @property
    def step_answered(self) -> int | None:
        """The step that it answers, given by `step` or its stamp; None if the stamp lies between two steps."""
        step = self.nearest_step
        exact = self.step is not None or abs(self.stamp_ns - step * STEP_NS) <= STAMP_TOLERANCE_NS
        return step if exact else None


def problem(answer: Answer) -> str:
    """Returns a text that says why an answer cannot be used, whatever the state of the ego; empty if it can."""
    return next(chain(_problems(answer), ("",)))


def _problems(answer: Answer) -> Iterator[str]:
    target = answer.target
    if answer.fault or target is None:
        yield answer.fault or "it is empty"
    elif isinstance(target, EgoCommand):
        yield from _not_finite(acceleration=target.acceleration, yaw_rate=target.yaw_rate)
    elif isinstance(target, TwistTarget):
        if answer.frame not in BODY_FRAMES:
            yield f"frame_id is {shown(answer.frame)}, expected that of the ego's body, ego or base_link"
        yield from _not_finite(**{"twist.linear.x": target.speed, "twist.angular.z": target.yaw_rate})
    else:
        if answer.frame != MAP_FRAME:
            yield f"frame_id is {shown(answer.frame)}, expected {MAP_FRAME!r}"
        for row in np.flatnonzero(~(np.isfinite(target.x) & np.isfinite(target.y)))[:1]:
            yield f"pose {row} is not finite: {target.x[row]}, {target.y[row]}"
        for row in np.flatnonzero(np.diff(target.time) <= 0.0)[:1]:
            times = f"{target.time[row]:g} and {target.time[row + 1]:g} s"
            yield f"stamps of poses {row} and {row + 1} are {times}, expected ascending ones"


def _not_finite(**values: float) -> Iterator[str]:
    """Returns a text that names those of `values` that are not finite."""
    for name, value in values.items():
        if not isfinite(value):
            yield f"{name} is {value}, expected a finite value"
