"""From what is known of the agents of a scene to what a model reads, in one place for training and driving."""

from __future__ import annotations

import numpy as np

from litsim_predictor.inference.contract import HISTORY_CHANNELS, STATE_CHANNELS, AgentInputs
from litsim_predictor.inference.raster import MapRaster
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import BoolArray, FloatArray
from litsim_sim.maps.lane_map import LaneMap

LANE_ANGLE = 0.6  # [rad] a vehicle at a larger angle to the lane under it does not drive along it
LANE_DISTANCE = 3.0  # [m] nor does one farther from its centre line


def frame_headings(lane_map: LaneMap | None, x: FloatArray, y: FloatArray, yaw: FloatArray) -> FloatArray:
    """(n,) headings of the agent frames [rad]: of the lane where an agent drives along one, else its own."""
    if lane_map is None or not len(x):
        return yaw.copy()
    at = lane_map.nearest(x, y, yaw)
    along = (np.abs(wrap_angle(at.heading - yaw)) < LANE_ANGLE) & (np.abs(at.d) < LANE_DISTANCE)
    return np.where(along, at.heading, yaw)


def agent_inputs(
    series: FloatArray, observed: BoolArray, size: FloatArray, heading: FloatArray, raster: MapRaster
) -> AgentInputs:
    """Inputs of n agents.

    Args:
        series: (n, HISTORY, 4) x, y [m], yaw [rad], speed [m/s] in frame map, oldest first; any value where not
            observed.
        observed: (n, HISTORY); the last is True for all.
        size: (n, 2) length, width [m].
        heading: (n,) of the agent frames [rad]; see :func:`frame_headings`.
        raster: the map.
    """
    x, y = series[:, -1, 0], series[:, -1, 1]
    ahead, left = to_body(series[..., 0] - x[:, None], series[..., 1] - y[:, None], heading[:, None])
    yaw = wrap_angle(series[..., 2] - heading[:, None])
    history = np.stack([ahead, left, yaw, series[..., 3]], axis=-1)
    assert history.shape[-1] == HISTORY_CHANNELS
    history = np.where(observed[..., None], history, 0.0)
    state = np.concatenate([size, series[:, -1, 3:4], yaw[:, -1:]], axis=-1).astype(np.float32)
    assert state.shape[-1] == STATE_CHANNELS
    return AgentInputs(
        frame=np.stack([x, y, heading], axis=-1),
        history=history.astype(np.float32),
        observed=observed,
        state=state,
        raster=raster.cut(x, y, heading),
    )


def in_map(path: FloatArray, frame: FloatArray) -> FloatArray:
    """Positions (..., T, 2) [m] in frame map, of a `path` (..., T, 2) [m] in each agent frame (..., 3) [m, rad]."""
    cos, sin = np.cos(frame[..., 2:]), np.sin(frame[..., 2:])
    turned = np.stack([cos * path[..., 0] - sin * path[..., 1], sin * path[..., 0] + cos * path[..., 1]], axis=-1)
    return frame[..., None, :2] + turned
