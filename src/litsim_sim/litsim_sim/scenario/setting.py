"""What the stages ask of a scenario, be it one or several that are joined."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from litsim_sim.core.scene import IntArray
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.maps.lane_map import LaneMap
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.log_overlaps import LogOverlaps
from litsim_sim.scenario.signals import LinkSignals


class Setting(Protocol):
    """See :class:`litsim_sim.scenario.scenario.Scenario`, and :class:`.joined.JoinedScenario` of several."""

    @property
    def log(self) -> Log:
        """What everybody really did."""

    @property
    def ego_ids(self) -> IntArray:
        """(scenes,) the ego of each scene."""

    @property
    def identities(self) -> IntArray:
        """(N, 2) of each agent of the log, the seed of its scene and its id there: by these is drawn what is drawn."""

    @property
    def history_steps(self) -> int:
        """Step from which on egos are free."""

    @property
    def total_steps(self) -> int:
        """The last step."""

    @property
    def roi_m(self) -> float:
        """Radius around each agent off its log within which others are forecast and may be taken over [m]."""

    @property
    def steps_after_contact(self) -> tuple[int | None, ...]:
        """Of each scene, how many steps follow the first contact of its ego; None where the run goes on."""

    @property
    def log_overlaps(self) -> LogOverlaps:
        """Whose boxes overlap in the log itself, and when."""

    @property
    def last_logged(self) -> IntArray:
        """(scenes,) the last step at which anybody of the scene is logged."""

    @property
    def signals(self) -> LinkSignals | None:
        """What signals show at each step."""

    @property
    def net_path(self) -> Path:
        """File of the net."""

    @property
    def lane_map(self) -> LaneMap:
        """Its lanes."""

    @property
    def vehicle(self) -> VehicleModel:
        """How egos can move."""
