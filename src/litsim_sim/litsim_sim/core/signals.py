"""Traffic signals: states of signal groups at a step."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from litsim_sim.core.scene import ByteArray


class SignalState(IntEnum):
    """State of a signal group, numbered as MovementPhaseState of SAE J2735 and in ``litsim_msgs/SignalStates``."""

    UNAVAILABLE = 0  # unknown
    DARK = 1
    FLASHING_RED = 2  # stop, then proceed
    RED = 3
    RED_AMBER = 4  # about to be green
    GREEN_PERMISSIVE = 5  # go, but give way to what is in conflict
    GREEN = 6
    AMBER_PERMISSIVE = 7
    AMBER = 8
    FLASHING_AMBER = 9


STOP_STATES = (SignalState.RED, SignalState.RED_AMBER)
"""States that forbid passing the stop line."""
AMBER_STATES = (SignalState.AMBER, SignalState.AMBER_PERMISSIVE)
"""States that forbid it to whoever can still stop."""

SUMO_LETTERS = {
    SignalState.UNAVAILABLE: "O",
    SignalState.DARK: "O",
    SignalState.FLASHING_RED: "s",
    SignalState.RED: "r",
    SignalState.RED_AMBER: "u",
    SignalState.GREEN_PERMISSIVE: "g",
    SignalState.GREEN: "G",
    SignalState.AMBER_PERMISSIVE: "y",
    SignalState.AMBER: "y",
    SignalState.FLASHING_AMBER: "o",
}
"""SUMO's letter for each state; dark and unknown signals are ``O``, off."""

OF_SUMO = {
    "r": SignalState.RED,
    "u": SignalState.RED_AMBER,
    "s": SignalState.FLASHING_RED,
    "g": SignalState.GREEN_PERMISSIVE,
    "G": SignalState.GREEN,
    "y": SignalState.AMBER,
    "Y": SignalState.AMBER,
    "o": SignalState.FLASHING_AMBER,
    "O": SignalState.DARK,
}
"""Our state for each of SUMO's letters."""


@dataclass(frozen=True)
class SignalTable:
    """State of every signal group at one step; arrays (g,), groups in the order of the scenario.

    Attributes:
        step: integer step of 0.1 s since the start of the scenario.
        group: names of the groups.
        state: :class:`SignalState` of each.
    """

    step: int
    group: tuple[str, ...]
    state: ByteArray
