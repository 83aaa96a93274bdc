"""A learned model as the predictor of a running scene."""

from __future__ import annotations

from dataclasses import fields
from typing import cast

import numpy as np

from litsim_predictor.forecast import Egos, Forecast, Scope, selected
from litsim_predictor.inference.closed_lines import ClosedLines, Vehicles, among_traffic
from litsim_predictor.inference.contract import (
    DT,
    HISTORY,
    MANEUVERS,
    STRIDE,
    AgentFutures,
    AgentInputs,
    FurtherFutures,
    Network,
    NetworkOfManeuvers,
    NetworkOfScenes,
)
from litsim_predictor.inference.features import agent_inputs, on_lanes
from litsim_predictor.inference.in_map import forecast_in_map
from litsim_predictor.inference.lane_frames import NO_LANE_FRAMES, LaneFrameFinder, LaneFrames, from_lane_frames
from litsim_predictor.inference.raster import MapRaster
from litsim_predictor.inference.traffic import Traffic
from litsim_sim.core.errors import InputError
from litsim_sim.core.history import History
from litsim_sim.core.scene import AgentTable, FloatArray, IntArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.signals import LinkSignals


class LearnedPredictor:
    """Forecasts agents of interest jointly, by their history in the tables seen so far.

    Outside the region of interest, only the speed of the traffic is read. An agent's history is masked where it was not
    on the road, so that one that has just appeared is forecast as well. Agents of interest that are not wanted serve as
    context to the others.

    Args:
        network: a trained model.
        ego_id: the agent around which others matter; one per scene.
        scope: whom it forecasts, and what of it.
        lane_map, raster: the net; see :func:`.raster.raster_of_net`.
        signals: of the net; the network sees what they show at each step; see :mod:`.closed_lines`.
    """

    def __init__(
        self,
        network: Network,
        ego_id: Egos,
        scope: Scope,
        lane_map: LaneMap | None,
        raster: MapRaster,
        signals: LinkSignals | None = None,
    ) -> None:
        self._network, self._ego_id, self._scope = network, ego_id, scope
        self._lane_map, self._raster = lane_map, raster
        self._lanes = LaneFrameFinder(lane_map) if scope.along_lanes and lane_map is not None else None
        self._lines = ClosedLines(signals) if signals is not None and network.sees_signals else None
        self._history = History(STRIDE * (HISTORY - 1) + 1, ("x", "y", "yaw", "speed"))

    def observe(self, table: AgentTable) -> None:
        """See :class:`litsim_predictor.forecast.Predictor`."""
        self._history.push(table)

    @property
    def decodes_maneuvers(self) -> bool:
        """Whether :meth:`forecast` can be asked for a manoeuvre."""
        return isinstance(self._network, NetworkOfManeuvers)

    def forecast(self, table: AgentTable, maneuver: int | None = None) -> Forecast:
        """Forecast those that are wanted of `table`; see :class:`litsim_predictor.forecast.Forecast`.

        With `maneuver`, a number in MANEUVERS, they are forecast as if it were the most probable one; all of them must
        be of one scene.

        Raises:
            InputError: no forecast is finite, so that nobody could go by any of them.
        """
        self.observe(table)
        agents, asked = selected(table, self._ego_id, self._scope.roi_m, self._scope.wanted)
        if not len(asked):
            return Forecast.empty(table.step, DT, len(MANEUVERS))
        heading, lane_frames = self._frames(agents, asked)
        inputs, scene, rows = self._inputs(agents, heading, Traffic.of_table(table, self._history))
        futures = from_lane_frames(self._answer(inputs, rows[asked], scene, maneuver), lane_frames)
        forecast = forecast_in_map(futures, inputs.frame[rows[asked]], agents.take(asked))
        if not forecast.valid.any():
            raise InputError(
                f"{self._network.source}: none of the forecasts of {len(asked)} agents at step {table.step} is finite, "
                "expected a trained model in which no number overflows"
            )
        return forecast

    def _frames(self, agents: AgentTable, asked: IntArray) -> tuple[FloatArray, LaneFrames]:
        """Returns the headings (n,) of the frames of `agents`, and the lane frames of those `asked` (m,)."""
        if self._lane_map is None:
            return agents.yaw.copy(), NO_LANE_FRAMES
        nearest, along = on_lanes(self._lane_map, agents.x, agents.y, agents.yaw)
        heading = np.where(along, nearest.heading, agents.yaw)
        if self._lanes is None:
            return heading, NO_LANE_FRAMES
        return heading, self._lanes.ahead(nearest.take(asked), along[asked], agents.speed[asked])

    def _answer(self, inputs: AgentInputs, asked: IntArray, scene: IntArray, maneuver: int | None) -> AgentFutures:
        """Returns the network's output for the rows `asked` (m,); agents (n,) of one `scene` (n,) see each other."""
        if maneuver is not None:
            return cast(NetworkOfManeuvers, self._network).of_maneuver(inputs, asked, maneuver)
        if scene[0] == scene[-1]:
            return self._network(inputs, asked, self._scope.modes)
        if isinstance(self._network, NetworkOfScenes):
            rows = np.flatnonzero(np.isin(scene, scene[asked]))
            of_scenes = inputs if len(rows) == len(scene) else inputs.take(rows)
            first = np.flatnonzero(np.diff(scene[rows], prepend=-1))
            return self._network.of_scenes(of_scenes, np.searchsorted(rows, asked), first, self._scope.modes)
        answers, begins = [], np.flatnonzero(np.diff(scene[asked]))
        for rows in np.split(asked, begins + 1):
            begin, end = np.searchsorted(scene, scene[rows[0]]), np.searchsorted(scene, scene[rows[0]], "right")
            answers.append(self._network(inputs.take(slice(begin, end)), rows - begin, self._scope.modes))
        return _joined(answers)

    def _inputs(
        self, agents: AgentTable, heading: FloatArray, traffic: Traffic
    ) -> tuple[AgentInputs, IntArray, IntArray]:
        """Returns the inputs of `agents` (n,) and of closed stop lines, their scenes, and the agents' rows (n,)."""
        series, observed = self._history.window(agents.id, HISTORY, STRIDE)
        vehicles = Vehicles(series, observed, np.array([agents.length, agents.width]).T, heading, agents.scene)
        rows = np.arange(len(agents))
        if self._lines is not None:
            lines = self._lines.near(agents)
            (vehicles, rows), traffic = vehicles.beside(lines), among_traffic(traffic, lines)
        series, observed, size, heading, scene = vehicles
        return agent_inputs(series, observed, size, heading, self._raster, traffic, scene), scene, rows


def _joined(answers: list[AgentFutures]) -> AgentFutures:
    """Returns the answers for several scenes as one, in their order."""
    own = [f.name for f in fields(AgentFutures) if f.name != "further"]
    joined = {name: np.concatenate([getattr(answer, name) for answer in answers]) for name in own}
    before = np.cumsum([0, *(len(answer.maneuver) for answer in answers[:-1])])
    further = {
        f.name: np.concatenate([getattr(answer.further, f.name) for answer in answers]) for f in fields(FurtherFutures)
    }
    further["row"] = np.concatenate([answer.further.row + first for answer, first in zip(answers, before, strict=True)])
    return AgentFutures(**joined, further=FurtherFutures(**further))
