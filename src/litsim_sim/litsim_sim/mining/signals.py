"""Whether signals protect a turn: by what they showed, where the scenario knows that, otherwise by the net's plans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import sumolib

from litsim_sim.core.scene import ByteArray
from litsim_sim.core.signals import STOP_STATES, SignalState
from litsim_sim.scenario.scenario import Scenario

GREEN = frozenset("Gg")  # SUMO's signals: with right of way, and giving way
CLOSED = (*STOP_STATES, SignalState.FLASHING_RED)
UNKNOWN = (SignalState.UNAVAILABLE, SignalState.DARK)

Way = tuple[str, str]
"""A way through a junction: ids of the lanes before and after."""


class Protection(StrEnum):
    """How a turn is protected from those whose way it crosses."""

    PROTECTED = "protected"
    """They had red when it went; where that is not known, there is a phase in which it has green and they have not."""
    PERMISSIVE = "permissive"
    """They had no red when it went, or have no signal; where that is not known, it only ever has green with them."""
    NONE = "none"
    """It has no signal."""


@dataclass(frozen=True)
class WaySignals:
    """What is known of the signals of ways through junctions.

    Attributes:
        plans: of every way that a light of the net controls, its letter in each phase of the light.
        shown: of the ways of which the scenario knows it, the state at each step; arrays (steps,).
    """

    plans: Mapping[Way, tuple[str, ...]] = field(default_factory=dict)
    shown: Mapping[Way, ByteArray] = field(default_factory=dict)

    @classmethod
    def of(cls, scenario: Scenario) -> WaySignals:
        """What the net and the signals of a scenario say."""
        return cls(signal_plans(scenario.net_path), _shown(scenario))

    def protection(self, turning: Way, crossed: Way, step: int) -> Protection:
        """How one that goes `turning` at `step` is protected from those that go `crossed` at the same junction."""
        if turning not in self.plans and turning not in self.shown:
            return Protection.NONE
        if turning in self.shown and crossed in self.shown:
            state = self.shown[crossed][min(step, len(self.shown[crossed]) - 1)]
            if state not in UNKNOWN:
                return Protection.PROTECTED if state in CLOSED else Protection.PERMISSIVE
        own, theirs = self.plans.get(turning, ()), self.plans.get(crossed, ())
        if not (own and theirs):  # who has no signal never has red
            return Protection.PERMISSIVE
        # Two lights with different numbers of phases are not in step: at some time only one of them shows green.
        apart = len(own) != len(theirs)
        alone = apart or any(a in GREEN and b not in GREEN for a, b in zip(own, theirs, strict=True))
        return Protection.PROTECTED if alone else Protection.PERMISSIVE


def signal_plans(net: Path) -> dict[Way, tuple[str, ...]]:
    """The signal plans of a SUMO net that :func:`litsim_sim.maps.net_lanes.read_lanes` reads, by way."""
    read: Any = sumolib.net.readNet(str(net), withPrograms=True, lxml=False)
    plans = {}
    for light in read.getTrafficLights():
        phases = [phase.state for program in light.getPrograms().values() for phase in program.getPhases()]
        for before, after, index in light.getConnections():
            plans[before.getID(), after.getID()] = tuple(state[index] for state in phases if index < len(state))
    return plans


def _shown(scenario: Scenario) -> dict[Way, ByteArray]:
    signals = scenario.signals
    if signals is None:
        return {}
    groups = np.asarray(signals.link_group).tolist()
    return {
        (link.from_lane, link.to_lane): signals.states[group] for link, group in zip(signals.links, groups, strict=True)
    }
