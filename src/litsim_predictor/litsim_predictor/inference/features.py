"""Turns the agents of a scene into the inputs of a model, in one place for training and driving."""

from __future__ import annotations

import math

import numpy as np

from litsim_predictor.inference.contract import HISTORY_CHANNELS, STATE_CHANNELS, AgentInputs
from litsim_predictor.inference.raster import MapRaster
from litsim_predictor.inference.traffic import Traffic, poses
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import Bools2, Floats, Floats3, OutSingles2, OutSingles3, kernel
from litsim_sim.lane_map.lane_map import LaneMap, LanePosition

LANE_ANGLE = 0.6  # [rad] largest angle between a vehicle and a lane that it drives along
LANE_DISTANCE = 3.0  # [m] largest distance of such a vehicle from the centre line


def on_lanes(lane_map: LaneMap, x: FloatArray, y: FloatArray, yaw: FloatArray) -> tuple[LanePosition, BoolArray]:
    """Where poses (n,) are on the net, and which of them (n,) drive along their lanes."""
    nearest = lane_map.nearest(x, y, yaw)
    return nearest, (np.abs(wrap_angle(nearest.heading - yaw)) < LANE_ANGLE) & (np.abs(nearest.d) < LANE_DISTANCE)


def frame_headings(lane_map: LaneMap | None, x: FloatArray, y: FloatArray, yaw: FloatArray) -> FloatArray:
    """Returns the headings (n,) [rad] of the agent frames: of lanes where agents drive along them, else their own."""
    if lane_map is None or not len(x):
        return yaw.copy()
    nearest, along = on_lanes(lane_map, x, y, yaw)
    return np.where(along, nearest.heading, yaw)


def agent_inputs(
    series: FloatArray,
    observed: BoolArray,
    size: FloatArray,
    heading: FloatArray,
    raster: MapRaster,
    traffic: Traffic | None = None,
    scene: IntArray | None = None,
) -> AgentInputs:
    """Returns the inputs of n agents.

    Args:
        series: (n, HISTORY, 4) x, y [m], yaw [rad], speed [m/s] in frame map, oldest first; any value where not
            observed.
        observed: (n, HISTORY); the last is True for all.
        size: (n, 2) length, width [m].
        heading: (n,) of the agent frames [rad]; see :func:`frame_headings`.
        raster: the map.
        traffic: on their roads; None if they are all agents of one scene.
        scene: (n,) of `traffic` in which they are; None for the first.
    """
    assert series.shape[-1] == HISTORY_CHANNELS
    history, state = np.empty(series.shape, np.float32), np.empty((len(series), STATE_CHANNELS), np.float32)
    cos, sin = np.cos(heading), np.sin(heading)
    into_frames(np.ascontiguousarray(series), np.ascontiguousarray(observed), heading, cos, sin, history, state)
    state[:, :2] = size
    x, y = series[:, -1, 0], series[:, -1, 1]
    frame = poses(x, y, heading)
    traffic = Traffic.of_agents(frame, history, observed) if traffic is None else traffic
    return AgentInputs(
        frame=frame,
        history=history,
        observed=observed,
        state=state,
        raster=raster.cut(x, y, heading),
        traffic=traffic.ahead_of(frame, state[:, 2], scene),
    )


@kernel
def into_frames(
    series: Floats3,
    observed: Bools2,
    heading: Floats,
    cos: Floats,
    sin: Floats,
    history: OutSingles3,
    state: OutSingles2,
) -> None:
    """Write histories in agent frames, and present speed and yaw into `state`; see :class:`.contract.AgentInputs`.

    Args:
        series, observed, heading: see :func:`agent_inputs`.
        cos, sin: (n,) of the headings.
        history: (n, HISTORY, HISTORY_CHANNELS), zeros where not observed.
        state: (n, STATE_CHANNELS), whose last two channels are written.
    """
    agents, steps = observed.shape
    for i in range(agents):
        for t in range(steps):
            dx, dy = series[i, t, 0] - series[i, -1, 0], series[i, t, 1] - series[i, -1, 1]
            turn = series[i, t, 2] - heading[i] + math.pi
            if not 0.0 <= turn < 2.0 * math.pi:
                turn %= 2.0 * math.pi
                turn = 0.0 if turn >= 2.0 * math.pi else turn  # the remainder can round up to a full turn
            seen = observed[i, t]
            history[i, t, 0] = dx * cos[i] + dy * sin[i] if seen else 0.0
            history[i, t, 1] = dy * cos[i] - dx * sin[i] if seen else 0.0
            history[i, t, 2] = turn - math.pi if seen else 0.0
            history[i, t, 3] = series[i, t, 3] if seen else 0.0
        state[i, 2], state[i, 3] = series[i, -1, 3], history[i, -1, 2]


def in_map(path: FloatArray, frame: FloatArray) -> FloatArray:
    """Positions (..., T, 2) [m] in frame map, of a `path` (..., T, 2) [m] in each agent frame (..., 3) [m, rad]."""
    cos, sin = np.cos(frame[..., 2:]), np.sin(frame[..., 2:])
    turned = np.stack([cos * path[..., 0] - sin * path[..., 1], sin * path[..., 0] + cos * path[..., 1]], axis=-1)
    return frame[..., None, :2] + turned
