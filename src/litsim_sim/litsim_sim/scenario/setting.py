"""Interface of a scenario to the stages, for a single scenario and for several batched ones."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from litsim_sim.core.scene import IntArray
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.log_overlaps import LogOverlaps
from litsim_sim.scenario.signals import LinkSignals


class Setting(Protocol):
    """See :class:`litsim_sim.scenario.scenario.Scenario`, and :class:`.batched.BatchedScenario` of several."""

    @property
    def log(self) -> Log:
        """Recorded motion of all agents."""

    @property
    def ego_ids(self) -> IntArray:
        """(scenes,) the ego of each scene."""

    @property
    def identities(self) -> IntArray:
        """(N, 2) seed of its scene and id there of each agent of the log; they seed its random draws."""

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
        """(scenes,) number of steps that follow the first contact of the ego; None if the run continues."""

    @property
    def log_overlaps(self) -> LogOverlaps:
        """Overlaps of boxes in the log itself."""

    @property
    def last_logged(self) -> IntArray:
        """(scenes,) the last step at which any agent of the scene is logged."""

    @property
    def signals(self) -> LinkSignals | None:
        """States of the signals at each step; None if unknown."""

    @property
    def net_path(self) -> Path:
        """File of the net."""

    @property
    def lane_map(self) -> LaneMap:
        """Lanes of the net."""

    @property
    def vehicle(self) -> VehicleModel:
        """Vehicle model of the egos."""
