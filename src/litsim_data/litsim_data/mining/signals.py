"""Whether signals protect a turn: by their states, if the scenario knows them, else by the signal plans of the net."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np

from litsim_sim.core.scene import ByteArray
from litsim_sim.core.signals import STOP_STATES, SignalState
from litsim_sim.lane_map.net_lanes import parse_net
from litsim_sim.scenario.scenario import Scenario

GREEN = frozenset("Gg")  # SUMO's signals: with right of way, and giving way
CLOSED = (*STOP_STATES, SignalState.FLASHING_RED)
UNKNOWN = (SignalState.UNAVAILABLE, SignalState.DARK)

Way = tuple[str, str]
"""A way through a junction: ids of the lanes before and after."""


class Protection(StrEnum):
    """How a turn is protected from the traffic whose way it crosses."""

    PROTECTED = "protected"
    """The crossed traffic had red; if unknown, every program that lets the turn go has a phase for it alone."""
    PERMISSIVE = "permissive"
    """The crossed traffic did not have red, or has no signal; if unknown, some program lets the turn go only with it.
    """
    NONE = "none"
    """The turn has no signal."""


@dataclass(frozen=True)
class WaySignals:
    """Signals of ways through junctions.

    Attributes:
        plans: SUMO's letters in the phases of each program of the traffic light, by way that the net controls.
        shown: (steps,) states, by way whose signals the scenario knows.
    """

    plans: Mapping[Way, tuple[str, ...]] = field(default_factory=dict)
    shown: Mapping[Way, ByteArray] = field(default_factory=dict)

    @classmethod
    def of(cls, scenario: Scenario) -> WaySignals:
        """Returns the signals of a scenario and of its net."""
        return cls(signal_plans(scenario.net_path), _shown(scenario))

    def protection(self, turning: Way, crossed: Way, step: int) -> Protection:
        """Returns how a vehicle on way `turning` at `step` is protected from traffic on way `crossed` there."""
        if turning not in self.plans and turning not in self.shown:
            return Protection.NONE
        if turning in self.shown and crossed in self.shown:
            state = self.shown[crossed][min(step, len(self.shown[crossed]) - 1)]
            if state not in UNKNOWN:
                return Protection.PROTECTED if state in CLOSED else Protection.PERMISSIVE
        own, theirs = self.plans.get(turning, ()), self.plans.get(crossed, ())
        if not (own and theirs):  # traffic without a signal never has red
            return Protection.PERMISSIVE
        # Which program ran is not known. Only those of one light belong together, by their place.
        alone = [_goes_alone(a, b) for a, b in zip(own, theirs, strict=False) if GREEN & {*a}]
        return Protection.PROTECTED if alone and all(alone) else Protection.PERMISSIVE


def _goes_alone(own: str, theirs: str) -> bool:
    """Returns whether one of two ways has green while the other has not, by their letters in the phases of a program.

    Two lights with different numbers of phases are not synchronised: at some time only one shows green.
    """
    return len(own) != len(theirs) or any(a in GREEN and b not in GREEN for a, b in zip(own, theirs, strict=True))


def signal_plans(net: Path) -> dict[Way, tuple[str, ...]]:
    """Returns the signal plans of a SUMO net, by way; see :class:`WaySignals`."""
    plans = {}
    for light in parse_net(net, programs=True).getTrafficLights():
        programs = [[phase.state for phase in program.getPhases()] for program in light.getPrograms().values()]
        for before, after, index in light.getConnections():
            plans[before.getID(), after.getID()] = tuple(
                "".join(state[index] for state in phases if index < len(state)) for phases in programs
            )
    return plans


def _shown(scenario: Scenario) -> dict[Way, ByteArray]:
    signals = scenario.signals
    if signals is None:
        return {}
    groups = np.asarray(signals.link_group).tolist()
    return {
        (link.from_lane, link.to_lane): signals.states[group] for link, group in zip(signals.links, groups, strict=True)
    }
