"""Modes of motion of agents, and their colours in pictures, the report and live views."""

from __future__ import annotations

from enum import IntEnum

from litsim_sim.core.signals import SignalState
from litsim_sim.core.takeover import TakeoverState


class Mode(IntEnum):
    """What moves an agent; the first three as in :class:`litsim_sim.core.scene.Controller`."""

    LOG = 0
    POLICY = 1
    EGO = 2
    HANDBACK = 3
    OWN_INTENT = 4
    ABSENT = 5


COLOURS = {  # as in the LitSim paper, and in assets/report.css
    Mode.EGO: ("#d62728", "ego"),
    Mode.POLICY: ("#2ca02c", "taken over"),
    Mode.HANDBACK: ("#86dcb5", "handing back"),
    Mode.OWN_INTENT: ("#17a2b8", "own intent"),
    Mode.LOG: ("#f2c230", "log"),
}
"""Colour and name of each mode."""

MODES_OFF_LOG = {
    TakeoverState.HELD: Mode.POLICY,
    TakeoverState.OWN_INTENT: Mode.OWN_INTENT,
    TakeoverState.HANDBACK: Mode.HANDBACK,
    TakeoverState.RELEASED: Mode.HANDBACK,
}
"""Mode of an agent under POLICY, by the state of its takeover."""

INK, FAINT, ROAD = "#30343b", "#c9cdd3", "#e6e8eb"
"""Colours of text and outlines, of background elements, and of the road."""

CONFLICT = "#b3127b"
"""Colour of predicted overlaps."""

LIGHT_NAMES = {
    **dict.fromkeys(SignalState, ""),
    **dict.fromkeys((SignalState.FLASHING_RED, SignalState.RED, SignalState.RED_AMBER), "red"),
    **dict.fromkeys((SignalState.GREEN_PERMISSIVE, SignalState.GREEN), "green"),
    **dict.fromkeys((SignalState.AMBER_PERMISSIVE, SignalState.AMBER, SignalState.FLASHING_AMBER), "amber"),
}
"""Name of the colour that a light shows; empty if it is dark or unknown."""
_RGB = {"red": (0.9, 0.1, 0.1), "amber": (1.0, 0.7, 0.0), "green": (0.1, 0.8, 0.2), "": (0.5, 0.5, 0.5)}
LIGHTS = {state: _RGB[name] for state, name in LIGHT_NAMES.items()}
"""Red, green and blue, from 0 to 1, of lights in viewers, by what they show."""


def colour_of(controller: int) -> str:
    """Returns the colour of agents under a :class:`litsim_sim.core.scene.Controller`."""
    return COLOURS[Mode(controller)][0]
