"""Latency of what drives the ego: its answer to a step counts some steps later."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor, isfinite
from operator import itemgetter
from typing import Any, Generic, TypeVar

from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import Parameters
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.stages import BRIDGE

MEASURED = "measured"
"""An answer counts as much later as it takes, to the nearest step."""
NONE = "0"
NAME = "latency"  # of the parameter of the bridge, which runs in process know as well
LONGEST_S = 60.0

T = TypeVar("T")


def latency_steps(text: str) -> int | None:
    """Returns the steps of a latency in seconds; None for MEASURED. Raises ValueError for others."""
    if text == MEASURED:
        return None
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    steps = round(seconds / STEP_S) if isfinite(seconds) else -1
    if not (0.0 <= seconds <= LONGEST_S and abs(steps * STEP_S - seconds) < 1e-6):
        raise ValueError(
            f"{NAME} is {text}, expected {MEASURED}, or a multiple of {STEP_S:g} s from 0 to {LONGEST_S:g}"
        )
    return steps


def latency_text(text: str) -> str:
    """Returns a latency as it is written in identities: 0.10 as 0.1. Raises as :func:`latency_steps`."""
    steps = latency_steps(text)
    return MEASURED if steps is None else f"{steps * STEP_S:g}"


def latency_in(parameters: Parameters | None) -> str:
    """Returns the latency among the parameters of a run, by stage and name; raises InputError if it is none."""
    text = str((parameters or {}).get(BRIDGE, {}).get(NAME, NONE))
    try:
        return latency_text(text)
    except ValueError as error:
        raise InputError(f"{BRIDGE}.{error}") from error


def without_latency(parameters: Parameters) -> dict[str, Mapping[str, Any]]:
    """Returns the parameters of a run but its latency."""
    bridge = {name: value for name, value in parameters.get(BRIDGE, {}).items() if name != NAME}
    others: dict[str, Mapping[str, Any]] = {stage: values for stage, values in parameters.items() if stage != BRIDGE}
    return others | ({BRIDGE: bridge} if bridge else {})


class Delayed(Generic[T]):
    """Answers that come into force after a latency; the answer in force is the due answer to the latest step."""

    def __init__(self, latency: str = NONE) -> None:
        """Delay answers by a latency, as :func:`latency_steps` has it."""
        self._steps = latency_steps(latency)
        self._waiting: list[tuple[int, int, T]] = []  # step from which it counts, and which it answers
        self._newest: tuple[int, T] | None = None

    def put(self, step: int, answer: T, took_s: float, now: int) -> None:
        """Take the answer to `step`, which took `took_s` seconds; `now` is the present step, later if it was missed."""
        later = floor(took_s / STEP_S + 0.5) if self._steps is None else self._steps
        self._waiting.append((max(step + later, now), step, answer))

    def in_force(self, step: int) -> T | None:
        """Returns the answer in force at a step; None before the first. Steps are asked for in order."""
        arrived = [(answered, answer) for due, answered, answer in self._waiting if due <= step]
        self._waiting = [waiting for waiting in self._waiting if waiting[0] > step]
        if self._newest is not None:
            arrived.append(self._newest)
        self._newest = max(arrived, key=itemgetter(0), default=None)
        return None if self._newest is None else self._newest[1]
