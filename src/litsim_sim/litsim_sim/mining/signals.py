"""What a net's signal plans say of the ways through its junctions. Which light was on when is in no scenario."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any

import sumolib

GREEN = frozenset("Gg")  # SUMO's signals: with right of way, and giving way

Way = tuple[str, str]
"""A way through a junction: ids of the lanes before and after."""

SignalPlans = Mapping[Way, tuple[str, ...]]
"""The signal of every signalised way in each phase of its light."""


class Protection(StrEnum):
    """How a turn is protected from those whose way it crosses."""

    PROTECTED = "protected"
    """In some phase it has green and they have not: whether it went then is not known."""
    PERMISSIVE = "permissive"
    """It only ever has green together with them."""
    NONE = "none"
    """It has no signal."""


def signal_plans(net: Path) -> dict[Way, tuple[str, ...]]:
    """The signal plans of a SUMO net that :func:`litsim_sim.maps.net_lanes.read_lanes` reads, by way."""
    read: Any = sumolib.net.readNet(str(net), withPrograms=True, lxml=False)
    plans = {}
    for light in read.getTrafficLights():
        phases = [phase.state for program in light.getPrograms().values() for phase in program.getPhases()]
        for before, after, index in light.getConnections():
            plans[before.getID(), after.getID()] = tuple(state[index] for state in phases if index < len(state))
    return plans


def protection(plans: SignalPlans, turning: Way, crossed: Way) -> Protection:
    """How the way `turning` is protected from the way `crossed` at the same junction, by the plan of its light."""
    own, theirs = plans.get(turning), plans.get(crossed, ())
    if own is None:
        return Protection.NONE
    alone = len(own) != len(theirs) or any(a in GREEN and b not in GREEN for a, b in zip(own, theirs, strict=True))
    return Protection.PROTECTED if alone else Protection.PERMISSIVE
