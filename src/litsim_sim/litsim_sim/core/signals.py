"""Traffic signals: what the groups of a junction's signals show at a step."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from litsim_sim.core.scene import BoolArray, ByteArray


class SignalState(IntEnum):
    """What a signal group shows, numbered as MovementPhaseState of SAE J2735 and as in ``litsim_msgs/SignalStates``."""

    UNAVAILABLE = 0  # nothing is known of it
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
"""At which nobody may pass the stop line."""

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
"""The letter of SUMO's states for each of ours; of signals that are dark or unknown SUMO has ``O``, off."""

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
    """What every signal group shows at one step; arrays (g,), groups in the order of the scenario.

    Attributes:
        step: integer step of 0.1 s since the start of the scenario.
        group: names of the groups.
        state: :class:`SignalState` of each.
    """

    step: int
    group: tuple[str, ...]
    state: ByteArray

    def __len__(self) -> int:
        return len(self.group)

    @property
    def stop(self) -> BoolArray:
        """(g,) groups at which nobody may pass."""
        return np.isin(self.state, STOP_STATES)
