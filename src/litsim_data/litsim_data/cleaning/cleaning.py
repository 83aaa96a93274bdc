"""Cleaning of a whole recording: noisy positions become box centres with the kinematics of vehicles.

Module `track_fit` cleans one track, `report` measures the changes.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
from scipy.spatial import KDTree
from tqdm import tqdm

from litsim_data.cleaning.report import CleaningReport, measure
from litsim_data.cleaning.track_fit import REAR_AXLE, CleaningConfig, fit_track
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import FloatArray
from litsim_sim.scenario.recording import COLUMNS

FRONT = 0.5  # distance of the front centre ahead of the box centre [lengths]
LEADS_NOWHERE = 5.0  # [m] tracks of a smaller extent are given a hint of their direction
MOVED = 1.0  # [m] shortest displacement with a reliable direction
NEIGHBOUR = 30.0  # [m] within which directions of other vehicles serve as hints, those of the same lane first
NEIGHBOURS = 16  # most neighbours considered
JUMP = 60.0  # [m] largest plausible measuring error between frames


def clean(tracks: pd.DataFrame, config: CleaningConfig | None = None) -> tuple[pd.DataFrame, CleaningReport]:
    """Returns tracks of FRONT centres, cleaned by :func:`smoothed`, and figures before and after.

    Their yaw, speed and acceleration are for the report; yaw is a hint, too, of the direction of vehicles that hardly
    move.

    Raises:
        InputError: as :func:`smoothed`.
    """
    cleaned = smoothed(tracks, ahead=FRONT, measured=False, config=config)
    order = ["vehicle_id", "frame"]
    raw = tracks.sort_values(order, ignore_index=True)
    return cleaned, measure(raw, cleaned.sort_values(order, ignore_index=True))


def smoothed(
    tracks: pd.DataFrame, *, ahead: float, measured: bool, config: CleaningConfig | None = None
) -> pd.DataFrame:
    """Smooths positions, and derives box centres, headings, speeds and accelerations that agree with them.

    Vehicles are cleaned independently, except that one which hardly moves gets the direction of those around it.

    Args:
        tracks: vehicle_id, frame, x, y, length, width, kind, lane and, if known, yaw, speed and acceleration, all of
            them finite; in frame map and SI units at 10 Hz, one row per vehicle and frame, without holes within a
            track, in any order.
        ahead: distance of the point x, y ahead of the box centre [lengths].
        measured: whether column yaw holds measured headings, to be kept to, rather than hints.
        config: cutoff periods.

    Returns:
        The recording's table (:data:`litsim_sim.scenario.recording.COLUMNS`), sorted by frame and vehicle.

    Raises:
        InputError: a vehicle jumps by more than 60 m.
    """
    table, by_vehicle = _sorted(tracks)
    state = _fitted(table, by_vehicle, config or CleaningConfig(), ahead, measured=measured)
    yaw, lever = state[:, 2], REAR_AXLE * table["length"].to_numpy(np.float64)
    cleaned = table[["vehicle_id", "frame", "length", "width", "kind", "lane"]].assign(
        x=state[:, 0] + lever * np.cos(yaw),
        y=state[:, 1] + lever * np.sin(yaw),
        yaw=wrap_angle(yaw),
        speed=state[:, 3],
        acceleration=state[:, 4],
    )
    return cleaned[list(COLUMNS)].astype(COLUMNS).sort_values(["frame", "vehicle_id"], ignore_index=True)


def _fitted(
    table: pd.DataFrame, tracks: list[slice], config: CleaningConfig, ahead: float, *, measured: bool
) -> FloatArray:
    """Returns the motions (n, 5) of all vehicles: rear axle x, y [m], yaw [rad], speed [m/s], acceleration [m/s2].

    `tracks` are the rows of each vehicle in `table`.
    """
    points = table[["x", "y"]].to_numpy(np.float64)
    length, share = table["length"].to_numpy(np.float64), ahead + REAR_AXLE
    yaw = table["yaw"].to_numpy(np.float64) if measured else None
    state = np.empty((len(table), 5))

    def fit(rows: slice, hint: float | None) -> None:
        headings = None if yaw is None else yaw[rows]
        motion = fit_track(points[rows], share * float(np.median(length[rows])), config, hint, headings)
        state[rows] = np.column_stack([motion.axle, motion.yaw, motion.speed, motion.acceleration])
        bar.update()

    with tqdm(total=len(tracks), unit=" vehicles", leave=False, disable=None) as bar:
        waiting = []
        for rows in tracks:
            if np.linalg.norm(np.ptp(points[rows], axis=0)) < LEADS_NOWHERE:
                waiting.append(rows)
            else:
                fit(rows, None)
        for rows, hint in zip(waiting, _hints(table, waiting, state), strict=True):
            fit(rows, float(hint))
            if rows.stop - rows.start == 1 and "speed" in table:  # one position says nothing about speed
                state[rows, 3] = table["speed"].to_numpy()[rows]
    return state


def front_centres(table: pd.DataFrame) -> pd.DataFrame:
    """Returns a recording's table with front centres in place of box centres, as input of :func:`clean`."""
    yaw, half = table["yaw"].to_numpy(), FRONT * table["length"].to_numpy()
    return table.assign(x=table["x"] + half * np.cos(yaw), y=table["y"] + half * np.sin(yaw))


def _sorted(tracks: pd.DataFrame) -> tuple[pd.DataFrame, list[slice]]:
    """Returns the tracks by vehicle and frame, and the rows of each vehicle.

    The tables of recordings cannot lack what the fit needs, but jump.

    Raises:
        InputError: a vehicle does.
    """
    table = tracks.sort_values(["vehicle_id", "frame"], ignore_index=True)
    vehicle, frame = table["vehicle_id"].to_numpy(), table["frame"].to_numpy()
    same = vehicle[1:] == vehicle[:-1]
    jumps = same & (np.hypot(np.diff(table["x"]), np.diff(table["y"])) > JUMP)
    if jumps.any():
        row = int(np.argmax(jumps))
        raise InputError(
            f"tracks to clean: vehicle_id {vehicle[row]}: frame {frame[row]} is followed by a jump of more than "
            f"{JUMP:g} m (next row: frame {frame[row + 1]}); {int(jumps.sum())} such places"
        )
    bounds = [0, *(np.flatnonzero(~same) + 1).tolist(), len(table)]
    return table, [slice(*pair) for pair in pairwise(bounds)]


def _hints(table: pd.DataFrame, waiting: list[slice], state: FloatArray) -> FloatArray:
    """Returns directions (k,) [rad] for the vehicles `waiting`: as published, or those of vehicles around them, or 0.

    Args:
        table, waiting: all tracks, and the rows of these vehicles in it.
        state: (n, 5) as of :func:`_fitted`; valid for all but the waiting vehicles.
    """
    if "yaw" in table:
        yaw = table["yaw"].to_numpy(np.float64)
        return np.array([np.arctan2(np.sin(yaw[rows]).sum(), np.cos(yaw[rows]).sum()) for rows in waiting])
    hints = _directions_around(table, waiting, state)
    positions = table[["x", "y"]].to_numpy(np.float64)
    for k, rows in enumerate(waiting):  # a clear displacement in another direction overrides the hint
        own = positions[rows]
        way = own[-3:].mean(axis=0) - own[:3].mean(axis=0)
        moved = float(np.linalg.norm(way))
        if moved > MOVED and way @ [np.cos(hints[k]), np.sin(hints[k])] < 0.5 * moved:
            hints[k] = np.arctan2(way[1], way[0])
    return hints


def _directions_around(table: pd.DataFrame, waiting: list[slice], state: FloatArray) -> FloatArray:
    """Returns directions (k,) [rad] of the nearest vehicles not `waiting`, those of its lane first; 0 without any."""
    sampled = np.ones(len(table), np.bool_)
    for rows in waiting:
        sampled[rows] = False
    sampled[sampled] = np.arange(int(sampled.sum())) % 5 == 0  # twice a second is plenty
    hints = np.zeros(len(waiting))
    if not waiting or not sampled.any():
        return hints
    lane, directions = table["lane"].to_numpy(), state[sampled, 2]
    lanes = lane[sampled]
    tree = KDTree(state[sampled, :2])
    for k, rows in enumerate(waiting):
        place = table[["x", "y"]].iloc[rows].median().to_numpy()
        distance, neighbours = tree.query(place, k=NEIGHBOURS, distance_upper_bound=NEIGHBOUR)
        neighbours = neighbours[np.isfinite(distance)]
        if len(neighbours):
            same = neighbours[(lanes[neighbours] == lane[rows.start]) & (lane[rows.start] >= 0)]
            hints[k] = directions[(same if len(same) else neighbours)[0]]
    return hints
