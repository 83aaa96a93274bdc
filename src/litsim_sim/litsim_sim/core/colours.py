"""Modes of motion of agents, and their colours in pictures, the report and live views."""

from __future__ import annotations

from enum import IntEnum


class Mode(IntEnum):
    """What moves an agent; the first three as in :class:`litsim_sim.core.scene.Controller`."""

    LOG = 0
    POLICY = 1
    EGO = 2
    HANDBACK = 3
    ABSENT = 4


COLOURS = {  # as in the LitSim paper, and in assets/report.css
    Mode.EGO: ("#d62728", "ego"),
    Mode.POLICY: ("#2ca02c", "taken over"),
    Mode.HANDBACK: ("#86dcb5", "handing back"),
    Mode.LOG: ("#f2c230", "log"),
}
"""Colour and name of each mode."""

INK, FAINT, ROAD = "#30343b", "#c9cdd3", "#e6e8eb"
"""Colours of text and outlines, of background elements, and of the road."""

CONFLICT = "#b3127b"
"""Colour of predicted overlaps."""


def colour_of(controller: int) -> str:
    """Returns the colour of agents under a :class:`litsim_sim.core.scene.Controller`."""
    return COLOURS[Mode(controller)][0]
