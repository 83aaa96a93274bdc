"""One scene: the agents of a frame of recorded tracks, as a model reads them, and their futures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_predictor.inference.contract import AgentInputs
from litsim_predictor.inference.features import agent_inputs
from litsim_predictor.inference.lane_frames import NO_LANE_FRAMES, LaneFrames
from litsim_predictor.inference.raster import MapRaster
from litsim_research.predictors.data.tracks import Tracks
from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Scene:
    """The n agents of one frame, and their futures.

    Attributes:
        inputs: what a model reads of them.
        future: (n, HORIZON, 2) box centres in the agent frames [m]; zeros where unknown.
        future_known: (n, HORIZON) whether the agent is seen then.
        target: (n,) whether losses and scores may refer to the agent.
        lane_frames: of the agents whose lanes bend; empty in training.
    """

    inputs: AgentInputs
    future: FloatArray
    future_known: BoolArray
    target: BoolArray
    lane_frames: LaneFrames = NO_LANE_FRAMES

    def around(self, agent: int, metres: float) -> Scene:
        """Returns the scene reduced to the agents within `metres` [m] of the agent in row `agent`."""
        place = self.inputs.frame[:, :2]
        near = np.hypot(*(place - place[agent]).T) <= metres
        bends = near[self.lane_frames.row]
        lane_frames = LaneFrames((near.cumsum() - 1)[self.lane_frames.row[bends]], self.lane_frames.pose[bends])
        return Scene(self.inputs.take(near), self.future[near], self.future_known[near], self.target[near], lane_frames)


def cut_scene(tracks: Tracks, rows: IntArray, raster: MapRaster | None = None) -> Scene:
    """Returns the scene of the vehicles in `rows` of one frame; `raster` replaces the map of `tracks` unless None."""
    past, observed = tracks.history(rows)
    later, recorded = tracks.future(rows)
    recorded &= ~tracks.is_line[rows, None]
    inputs = agent_inputs(
        tracks.motion[past], observed, tracks.size[rows], tracks.heading[rows], raster or tracks.raster
    )
    x, y, heading = inputs.frame.T[..., None]
    future = np.stack(to_body(tracks.motion[later, 0] - x, tracks.motion[later, 1] - y, heading), axis=-1)
    return Scene(
        inputs=inputs,
        future=np.where(recorded[..., None], future, 0.0),
        future_known=recorded,
        target=tracks.learnable[rows],
    )
