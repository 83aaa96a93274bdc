"""Detection of mirrored tables: the sides on which vehicles pass each other show whether the y axis points down.

Speeds and headings agree with the motion in a mirrored table as well. Sides do not: lanes are numbered from the left,
and in right-hand traffic oncoming vehicles pass on the left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import FloatArray, IntArray

INSTANTS = 400  # about as many instants are compared
INSTANT_S = 0.1  # [s] resolution of instants
MOVING = 2.0  # [m/s] smallest speed at which the direction of motion is reliable
WAY_MIN = 0.05  # [m] smallest distance between two rows, likewise
ABREAST = 10.0  # [m] largest longitudinal distance of vehicles that pass each other
BESIDE = (2.0, 9.0)  # [m] range of lateral distances
APART = 25.0  # [m] largest lateral distance of oncoming vehicles, which counts only where too few are within BESIDE
ALONG = 30.0  # [m] largest longitudinal distance of vehicles in adjacent lanes
SAME_WAY, ONCOMING = np.deg2rad(15.0), np.deg2rad(165.0)
PAIRS_MIN = 6  # fewest pairs of vehicles that are conclusive
DOWN = "y points down, which transform.mirror_y corrects"
NEAR = float(max(np.hypot(ALONG, BESIDE[1]), np.hypot(ABREAST, APART)))  # [m] no pair is farther apart
SHARE = 0.8  # smallest share of pairs that is conclusive


@dataclass(frozen=True)
class Sides:
    """Lateral positions of pairs of vehicles relative to each other.

    Attributes:
        oncoming: (p,) median distance to the left at which the other vehicle of an oncoming pair passes [m].
        next_lane: (q,) median distance to the left of the vehicle in the lane of the next higher number, for pairs that
            go the same way [m].
    """

    oncoming: FloatArray
    next_lane: FloatArray

    @classmethod
    def of(cls, table: pd.DataFrame) -> Sides:
        """The pairs in a table sorted by vehicle and time: vehicle_id, t [s], x, y [m], lane."""
        moving = _moving(table)
        instant = np.round(moving["t"].to_numpy() / INSTANT_S).astype(np.int64)
        every = max(1, len(np.unique(instant)) // INSTANTS)
        moving = moving.assign(instant=instant)[instant % every == 0].drop_duplicates(["vehicle_id", "instant"])
        found: dict[str, list[pd.DataFrame]] = {"oncoming": [], "next_lane": []}
        for _, rows in moving.groupby("instant", sort=True):
            one, other = KDTree(rows[["x", "y"]]).query_pairs(NEAR, output_type="ndarray").T
            for name, pairs in _pairs(rows, one, other).items():
                found[name].append(pairs)
        return cls(*(_medians(found[name]) for name in ("oncoming", "next_lane")))


def problems(table: pd.DataFrame) -> str:
    """Evidence that a table is mirrored, with figures; empty for none."""
    sides, said = Sides.of(table), []
    near = sides.oncoming[np.abs(sides.oncoming) < BESIDE[1]]
    oncoming = near if len(near) >= PAIRS_MIN else sides.oncoming
    right = oncoming < 0.0
    if len(right) >= PAIRS_MIN and right.mean() >= SHARE:
        said.append(
            f"oncoming vehicles pass on the right, {-np.median(oncoming):.1f} m beside, in {right.mean():.0%} of "
            f"{len(right)} encounters: {DOWN}, or traffic keeps to the left there"
        )
    left = sides.next_lane > 0.0
    if len(left) >= PAIRS_MIN and left.mean() > 1.0 - SHARE:
        mirrored = f"{DOWN}, or " if left.mean() >= SHARE else ""
        said.append(
            f"the lane of the next higher number is {np.median(sides.next_lane[left]):.1f} m to the left for "
            f"{left.mean():.0%} of {len(left)} pairs of vehicles, expected to the right: {mirrored}lanes are not "
            f"counted from the left in either direction, and field columns.lane has to go"
        )
    return "; ".join(said)


def _moving(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of moving vehicles, with the direction `course` [rad] to their next row."""
    vehicle, t, x, y = (table[name].to_numpy() for name in ("vehicle_id", "t", "x", "y"))
    dx, dy, dt = np.diff(x), np.diff(y), np.diff(t)
    way = np.hypot(dx, dy)
    keep = (vehicle[1:] == vehicle[:-1]) & (dt > 0) & (way > np.maximum(MOVING * dt, WAY_MIN))
    columns = table[["vehicle_id", "t", "x", "y", "lane"]].iloc[:-1][keep]
    return columns.assign(course=np.arctan2(dy, dx)[keep])


def _pairs(rows: pd.DataFrame, one: IntArray, other: IntArray) -> dict[str, pd.DataFrame]:
    """Pairs of `rows` of an instant, by kind: ids, and the distance of the second to the left of the first [m]."""
    ids, x, y, course, lane = (rows[name].to_numpy() for name in ("vehicle_id", "x", "y", "course", "lane"))
    swap = lane[one] > lane[other]
    one, other = np.where(swap, other, one), np.where(swap, one, other)
    ahead, left = to_body(x[other] - x[one], y[other] - y[one], course[one])
    turn = np.abs(wrap_angle(course[other] - course[one]))
    beside = (np.abs(left) > BESIDE[0]) & (np.abs(left) < BESIDE[1])
    apart = (np.abs(left) > BESIDE[0]) & (np.abs(left) < APART)
    chosen = {
        "oncoming": (turn > ONCOMING) & (np.abs(ahead) < ABREAST) & apart,
        "next_lane": (turn < SAME_WAY)
        & (np.abs(ahead) < ALONG)
        & beside
        & (lane[one] >= 1)
        & (lane[other] == lane[one] + 1),
    }
    return {
        name: pd.DataFrame({"one": ids[one[which]], "other": ids[other[which]], "left": left[which]})
        for name, which in chosen.items()
    }


def _medians(pairs: list[pd.DataFrame]) -> FloatArray:
    """Median distance to the left (k,) [m] of each pair of vehicles."""
    if not pairs:
        return np.zeros(0)
    return np.asarray(pd.concat(pairs).groupby(["one", "other"])["left"].median().to_numpy(), np.float64)
