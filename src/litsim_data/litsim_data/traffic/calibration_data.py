"""Calibration data in the development data (README of ``LITSIM_DATA``): car-following pairs and lane changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from litsim_data.traffic.calibration import Pairs
from litsim_data.traffic.motion import smooth
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray
from litsim_sim.io.parquet_input import read_table

I80_PAIRS = "ngsim/i80_car_following_pairs.parquet"
US101_TRACKS = "ngsim/us101_vehicle_tracks.parquet"
US101_WINDOWS = "ngsim/us101_0750_frames_0126_1149.parquet"

I80_COLUMNS = (
    *("pair", "period", "follower", "frame", "follower_y_m", "follower_speed_mps"),
    *("leader_y_m", "leader_speed_mps", "leader_length_m"),
)
US101_COLUMNS = ("period", "vehicle_id", "frame", "local_x_m", "local_y_m", "speed_mps", "space_headway_m")

WINDOWS_END = 1200  # frame of period 0 until which the windows reach that embedded traffic is compared with: left out
STEPS_MIN, STEPS_MAX = 250, 600  # of a stretch of car-following: shorter ones say little, longer ones are cut
LEADER_LENGTH = 4.6  # [m] US-101 tracks do not say which vehicle leads; an error goes into s0
JUMP = 2.5  # [m] by which the leader's place moves off its course within a step when another vehicle takes it
HEADWAY_MAX = 60.0  # [m] largest distance of a leader
GAP_MIN = 0.5  # [m]
SPEED_FILTER_S = 0.5  # [s] standard deviation of the filter that positions pass before they are differentiated
LANE_WIDTH = 3.66  # [m]
LANE_SLACK = 0.25  # [m] that a vehicle's centre must be beyond the line: driving on it is no lane change
LATERAL_FILTER_S = 1.0  # [s] of the running mean


def car_following(data: Path) -> Pairs:
    """All pairs of I-80 and US-101, the latter without the minutes that the complete windows cover.

    Raises:
        InputError: a file is missing or of another format.
    """
    purpose = "calibration needs it (README of the folder in LITSIM_DATA)"
    pairs = read_table(data / I80_PAIRS, I80_COLUMNS, purpose=purpose)
    tracks = read_table(data / US101_TRACKS, US101_COLUMNS, purpose=purpose)
    stretches = _i80_stretches(pairs) + _us101_stretches(tracks)
    columns: dict[str, FloatArray] = {}
    longest = max(len(stretch) for stretch in stretches)
    steps = np.array([len(stretch) for stretch in stretches])
    for name in ("position", "speed", "leader", "leader_speed"):
        columns[name] = np.stack(
            [np.pad(s[name].to_numpy(np.float64), (0, longest - len(s)), "edge") for s in stretches]
        )
    return Pairs(
        name=np.array([stretch.attrs["name"] for stretch in stretches]),
        follower=np.unique([stretch.attrs["driver"] for stretch in stretches], return_inverse=True)[1],
        valid=np.arange(longest) < steps[:, None],
        gap=columns["leader"] - columns["position"],
        position=columns["position"],
        speed=columns["speed"],
        leader_speed=columns["leader_speed"],
    )


def count_lane_changes(lateral: FloatArray, lane_width: float) -> int:
    """How often a track (k,) of lateral positions [m], measured from a lane's edge, goes over to another lane."""
    window = min(round(LATERAL_FILTER_S / STEP_S) | 1, len(lateral))
    smooth = pd.Series(lateral).rolling(window, center=True, min_periods=1).mean().to_numpy() / lane_width
    lane, changes = int(np.floor(smooth[0])), 0
    for value in smooth:
        if not lane - LANE_SLACK / lane_width <= value <= lane + 1 + LANE_SLACK / lane_width:
            lane, changes = int(np.floor(value)), changes + 1
    return changes


def _i80_stretches(table: pd.DataFrame) -> list[pd.DataFrame]:
    """Stretches of at most STEPS_MAX steps, in the columns position, speed, leader (its rear), leader_speed."""
    stretches = []
    for _, pair in table.sort_values("frame").groupby("pair"):
        gap = pair["leader_y_m"] - pair["leader_length_m"] - pair["follower_y_m"]
        clean = pd.DataFrame(
            {
                "position": pair["follower_y_m"],
                "speed": pair["follower_speed_mps"],
                "leader": pair["leader_y_m"] - pair["leader_length_m"],
                "leader_speed": pair["leader_speed_mps"],
            }
        )
        breaks = (np.diff(pair["frame"], prepend=pair["frame"].iloc[0] - 1) != 1) | (gap < GAP_MIN)
        driver = f"I-80 {pair['period'].iloc[0]} {pair['follower'].iloc[0]}"
        stretches += _cut(clean, breaks.to_numpy(), "I-80", driver)
    return stretches


def _us101_stretches(table: pd.DataFrame) -> list[pd.DataFrame]:
    """Where a vehicle keeps its lane and its leader; the leader's place is the follower's plus the space headway."""
    table = table[(table["period"] > 0) | (table["frame"] >= WINDOWS_END)]
    stretches = []
    for (period, vehicle), track in table.sort_values("frame").groupby(["period", "vehicle_id"]):
        front = track["local_y_m"] + track["space_headway_m"]
        moved = np.diff(front, prepend=front.iloc[0])
        lane = np.floor(track["local_x_m"] / LANE_WIDTH)
        breaks: BoolArray = np.abs(moved - track["speed_mps"].to_numpy() * STEP_S) > JUMP
        breaks |= np.diff(lane, prepend=lane.iloc[0]) != 0
        breaks |= np.diff(track["frame"], prepend=track["frame"].iloc[0] - 1) != 1
        breaks |= (track["space_headway_m"] < LEADER_LENGTH + GAP_MIN) | (track["space_headway_m"] > HEADWAY_MAX)
        raw = pd.DataFrame({"position": track["local_y_m"], "leader": front - LEADER_LENGTH})
        for stretch in _cut(raw, np.asarray(breaks), "US-101", f"US-101 {period} {vehicle}"):
            clean = stretch.apply(lambda column: smooth(column.to_numpy(), SPEED_FILTER_S / STEP_S))
            clean["speed"] = np.maximum(np.gradient(clean["position"], STEP_S), 0.0)
            clean["leader_speed"] = np.maximum(np.gradient(clean["leader"], STEP_S), 0.0)
            clean.attrs = stretch.attrs
            stretches.append(clean)
    return stretches


def _cut(rows: pd.DataFrame, breaks: np.ndarray, name: str, driver: str) -> list[pd.DataFrame]:
    """Runs of rows without a break, from STEPS_MIN to STEPS_MAX long."""
    runs = []
    for _, run in rows.groupby(np.cumsum(breaks)):
        parts = -(-len(run) // STEPS_MAX)
        for part in np.array_split(np.arange(len(run)), parts):
            if len(part) >= STEPS_MIN:
                piece = run.iloc[part].reset_index(drop=True)
                piece.attrs = {"name": name, "driver": driver}
                runs.append(piece)
    return runs
