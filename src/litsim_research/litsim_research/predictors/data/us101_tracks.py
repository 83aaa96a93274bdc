"""Single vehicles of US-101 with full tracks, and the leaders that their space headways give."""

from __future__ import annotations

import numpy as np
import pandas as pd

from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.data.us101_road import Us101Road
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.scenario import packaged

LEADER_SIZE = (4.7, 1.9)
"""Length and width [m] of vehicles of unknown size; the medians of the US-101 windows are 4.88 and 1.95 m."""
LEADER_JUMP = 1.0  # [m] a leader that moves by so much more or less than its follower in a frame is another vehicle
RATE_FRAMES = 5  # frames to each side over which rates of change are computed
DRIFT_SPEED = 2.0  # [m/s] least speed for headings; slower vehicles head almost along the road
HEADWAY_MOST = 100.0  # [m] longest space headway from which a leader is derived
SAME_VEHICLE = 1.0  # [m] distance of front centres in a frame, below which rows of two files are of the same vehicle
SAME_LEADER = 2.4  # [m] distance below which a leader is taken for a vehicle with a full track
LEADER_IDS = 10_000_000  # first id of leaders
US101_NET = packaged("nets/us101.net.xml")


def apart_from(table: pd.DataFrame, windows: pd.DataFrame, frames: tuple[int, int], road: Us101Road) -> BoolArray:
    """Returns a mask (R,) of the rows of single vehicles that are in no test window, by ids and by positions.

    Rows at the time of the test windows are left out as well, since their leaders may be test vehicles.
    """
    window = windows[windows["frame"].between(*frames)]
    front_x = window["x"] + 0.5 * window["length"] * np.cos(window["yaw"])
    front_y = window["y"] + 0.5 * window["length"] * np.sin(window["yaw"])
    x, y, _ = road.pose(table["local_y_m"].to_numpy(np.float64), table["local_x_m"].to_numpy(np.float64))
    here = pd.DataFrame({"vehicle": table["vehicle_id"], "frame": table["frame"], "x": x, "y": y})
    here = here[(table["period"] == 0) & table["frame"].between(*frames)]
    met = here.merge(pd.DataFrame({"frame": window["frame"], "front_x": front_x, "front_y": front_y}), on="frame")
    met = met[np.hypot(met["x"] - met["front_x"], met["y"] - met["front_y"]) < SAME_VEHICLE]
    tested_ids = set(window["vehicle_id"]) | set(met["vehicle"])
    tested = (table["period"] == 0) & (table["vehicle_id"].isin(tested_ids) | table["frame"].between(*frames))
    return np.asarray(~tested, np.bool_)


def with_leaders(table: pd.DataFrame, road: Us101Road) -> Tracks:
    """Returns vehicles with full tracks, as targets, and the leaders given by their space headways, as context."""
    runs = _Runs(table["vehicle_id"].to_numpy(np.int64), table["frame"].to_numpy(np.int64))
    along, across = table["local_y_m"].to_numpy(np.float64), table["local_x_m"].to_numpy(np.float64)
    # NGSIM's road coordinates are longer than the road, and its speeds are in these coordinates.
    speed = table["speed_mps"].to_numpy(np.float64) * road.scale(along)
    # NGSIM's local_x is positive to the right; a standing vehicle has no direction of motion.
    drift = np.arctan2(-runs.rate(across), np.maximum(runs.rate(along), DRIFT_SPEED))
    vehicles = _neutral(runs.vehicle, runs.frame, road.pose(along, across), drift, speed)

    headway = table["space_headway_m"].to_numpy(np.float64)
    front = np.minimum(along + headway, road.end)
    leads = (headway > LEADER_SIZE[0]) & (headway < HEADWAY_MOST) & (front < road.end)
    moved = np.abs(np.diff(front, prepend=0.0) - speed * STEP_S)
    lead = _Runs(runs.vehicle[leads], runs.frame[leads], moved[leads] > LEADER_JUMP)
    place = road.pose(front[leads], across[leads])
    leaders = _neutral(
        LEADER_IDS + lead.number,
        lead.frame,
        place,
        0.0,
        np.clip(lead.rate(front[leads]) * road.scale(front[leads]), 0.0, 40.0),
    )
    both = leaders.reset_index().merge(vehicles[["frame", "x", "y"]], on="frame", suffixes=("", "_other"))
    near = np.hypot(both["x"] - both["x_other"], both["y"] - both["y_other"]) < SAME_LEADER
    twice = leaders.index.isin(both["index"].to_numpy()[np.asarray(near)])
    scene = pd.DataFrame(pd.concat([vehicles, leaders[~twice]], ignore_index=True))
    target = scene["vehicle_id"].to_numpy() < LEADER_IDS
    return Tracks.from_table("us101_tracks", scene, US101_NET, target)


class _Runs:
    """Runs of rows: those of one vehicle in consecutive frames.

    Args:
        vehicle, frame: (R,) sorted by vehicle, then by frame.
        cut: (R,) mask of rows at which a new run begins in any case.
    """

    def __init__(self, vehicle: IntArray, frame: IntArray, cut: BoolArray | None = None) -> None:
        first = (np.diff(vehicle, prepend=-1) != 0) | (np.diff(frame, prepend=-1) != 1)
        first |= False if cut is None else cut
        self.vehicle, self.frame = vehicle, frame
        self.number: IntArray = np.cumsum(first) - 1
        begin = np.flatnonzero(first)
        end = np.append(begin[1:], len(vehicle)) - 1
        rows = np.arange(len(vehicle))
        self._before = np.maximum(rows - RATE_FRAMES, begin[self.number])
        self._after = np.minimum(rows + RATE_FRAMES, end[self.number])

    def rate(self, values: FloatArray) -> FloatArray:
        """Returns rates of change (R,) [1/s] of `values` (R,), over up to 1 s around each row; 0 in runs of one row."""
        span = (self._after - self._before) * STEP_S
        change = values[self._after] - values[self._before]
        return np.divide(change, span, out=np.zeros(len(values)), where=span > 0.0)


def _neutral(
    vehicle: IntArray,
    frame: IntArray,
    front: tuple[FloatArray, FloatArray, FloatArray],
    drift: FloatArray | float,
    speed: FloatArray,
) -> pd.DataFrame:
    """Returns columns of the neutral schema for vehicles of LEADER_SIZE.

    `front` are the x, y [m] of their front centres and the heading of the road there [rad], (n,) each; `drift` [rad] is
    their heading relative to the road.
    """
    x, y, yaw = front[0], front[1], front[2] + drift
    half = 0.5 * LEADER_SIZE[0]
    columns = {"vehicle_id": vehicle, "frame": frame, "x": x - half * np.cos(yaw), "y": y - half * np.sin(yaw)}
    return pd.DataFrame(columns | {"yaw": yaw, "speed": speed, "length": LEADER_SIZE[0], "width": LEADER_SIZE[1]})
