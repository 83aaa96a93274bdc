"""Trailers that are tracks of their own: recognised by a gap to the vehicle ahead that does not change."""

from __future__ import annotations

import numpy as np
import pandas as pd

from litsim_data.generic.counts import SHOWN, Counts
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import FloatArray
from litsim_sim.scenario.recording import BOUNDS

GAP_MAX = 2.0  # [m] between a vehicle and its trailer
GAP_CHANGE = 0.5  # [m] by which this gap may vary, by noise: of vehicles that follow each other it varies more
MOVING = 2.0  # [m/s] above which vehicles count as moving
WAY_MIN = 20.0  # [m] that they drive together at least
STRAIGHT = np.deg2rad(6.0)  # between their headings, within which they are one box


def joined(table: pd.DataFrame, counts: Counts) -> pd.DataFrame:
    """Returns the rows of 10 Hz with vehicles and trailers that stay in line as one box, by the vehicle's id.

    `table` has the neutral columns, sorted by vehicle and frame. Trailers that turn against their vehicle stay tracks
    of their own; `counts` is told of both.
    """
    towed = _towed(table)
    if not towed:
        return table
    concerned = {*towed, *towed.values()}
    tracks = {vehicle: table[table["vehicle_id"] == vehicle].set_index("frame") for vehicle in sorted(concerned)}
    boxes: dict[int, int] = {}
    for trailer in sorted(towed, key=lambda trailer: -_depth(trailer, towed)):  # the last of a chain first
        vehicle = towed[trailer]
        both = _together(tracks[vehicle], tracks[trailer])
        turned = np.abs(wrap_angle((both["yaw"] - both["yaw_towed"]).to_numpy()))
        box = _one_box(tracks[vehicle], tracks[trailer])
        if turned.max() <= STRAIGHT and box["length"].iloc[0] <= BOUNDS["length"][1]:
            tracks[vehicle] = box
            del tracks[trailer]
            boxes[trailer] = vehicle
    others = table[~table["vehicle_id"].isin(concerned)]
    rows = pd.concat([others, *(rows.reset_index()[list(table.columns)] for rows in tracks.values())])
    apart = {trailer: vehicle for trailer, vehicle in towed.items() if trailer not in boxes}
    if boxes:
        text = f"one box with the vehicle that tows them: {_listed(boxes)}"
        counts.tell("trailers", text, trailers_joined={str(trailer): vehicle for trailer, vehicle in boxes.items()})
    if apart:
        counts.tell(
            "trailers",
            f"{_listed(apart)}: tracks of their own, as they turn against the vehicle; they part if a run takes one of "
            "the two over",
            trailers_apart={str(trailer): vehicle for trailer, vehicle in apart.items()},
        )
    return rows.sort_values(["vehicle_id", "frame"], ignore_index=True)


def _listed(towed: dict[int, int]) -> str:
    """Returns a text on trailers and their vehicles."""
    named = [f"{trailer} of {vehicle}" for trailer, vehicle in sorted(towed.items())]
    return ", ".join(named[:SHOWN]) + (f" and {len(named) - SHOWN} more" if len(named) > SHOWN else "")


def _towed(table: pd.DataFrame) -> dict[int, int]:
    """Returns the vehicle ahead of each trailer, by the id of the trailer."""
    vehicle, frame, x, y, length = (table[name].to_numpy() for name in ("vehicle_id", "frame", "x", "y", "length"))
    by_frame = np.argsort(frame, kind="stable")
    starts = np.flatnonzero(np.r_[True, vehicle[1:] != vehicle[:-1]])
    towed: dict[int, int] = {}
    for first, end in zip(starts, np.r_[starts[1:], len(vehicle)], strict=True):
        row = (first + end) // 2
        now = by_frame[slice(*np.searchsorted(frame[by_frame], [frame[row], frame[row] + 1]))]
        reach = 0.5 * (length[now] + length[row]) + GAP_MAX
        near = now[(np.hypot(x[now] - x[row], y[now] - y[row]) <= reach) & (vehicle[now] != vehicle[row])]
        for other in vehicle[near].tolist():
            if _follows(table[vehicle == other].set_index("frame"), table[first:end].set_index("frame")):
                towed[int(vehicle[row])] = other
                break
    return towed


def _together(vehicle: pd.DataFrame, trailer: pd.DataFrame) -> pd.DataFrame:
    """Returns the rows of both at the frames at which both are there; columns of the trailer end in ``_towed``."""
    return vehicle.merge(trailer, left_index=True, right_index=True, suffixes=("", "_towed"))


def _follows(vehicle: pd.DataFrame, trailer: pd.DataFrame) -> bool:
    """Returns whether the front of `trailer` keeps its distance to the rear of `vehicle` wherever they move."""
    both = _together(vehicle, trailer)
    moving = both[both["speed"] > MOVING]
    if len(moving) < 2 or len(both) < 0.9 * len(trailer):
        return False
    way = np.hypot(np.ptp(moving["x"].to_numpy()), np.ptp(moving["y"].to_numpy()))
    rear, front = _end(moving, "", -0.5), _end(moving, "_towed", 0.5)
    apart = rear - front
    yaw = moving["yaw_towed"].to_numpy()
    gap, aside = to_body(apart[:, 0], apart[:, 1], yaw)
    near = np.abs(gap).max() <= GAP_MAX and np.abs(aside).max() <= GAP_MAX
    return bool(way >= WAY_MIN and near and np.ptp(gap) <= GAP_CHANGE)


def _end(rows: pd.DataFrame, suffix: str, lengths: float) -> FloatArray:
    """Returns the points (n, 2) [m] that lie `lengths` of the box ahead of its centre."""
    x, y, yaw, length = (rows[f"{name}{suffix}"].to_numpy() for name in ("x", "y", "yaw", "length"))
    return np.column_stack([x + lengths * length * np.cos(yaw), y + lengths * length * np.sin(yaw)])


def _one_box(vehicle: pd.DataFrame, trailer: pd.DataFrame) -> pd.DataFrame:
    """Returns the rows of a box around both, from the front of the vehicle on."""
    both = _together(vehicle, trailer)
    gap = float(np.median(np.hypot(*(_end(both, "", -0.5) - _end(both, "_towed", 0.5)).T)))
    before = float(vehicle["length"].iloc[0])
    length = before + gap + float(trailer["length"].iloc[0])
    back, yaw = 0.5 * (length - before), vehicle["yaw"].to_numpy()
    width = max(float(vehicle["width"].iloc[0]), float(trailer["width"].iloc[0]))
    x, y = vehicle["x"] - back * np.cos(yaw), vehicle["y"] - back * np.sin(yaw)
    return vehicle.assign(x=x, y=y, length=length, width=width)


def _depth(trailer: int, towed: dict[int, int]) -> int:
    """Returns how many vehicles are ahead of a trailer in its chain."""
    depth = 0
    while trailer in towed and depth < len(towed):
        trailer, depth = towed[trailer], depth + 1
    return depth
