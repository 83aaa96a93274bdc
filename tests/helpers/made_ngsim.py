"""Made-up traffic in NGSIM's official formats."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd

from litsim_data.generic.mapping import FOOT
from litsim_data.ngsim.formats import MOTORWAY_COLUMNS, STREET_COLUMNS, URBAN
from litsim_data.ngsim.sites import US101, Site
from litsim_sim.core.scene import STEP_S, FloatArray

PORTAL_HEADER = (
    "Vehicle_ID,Frame_ID,Total_Frames,Global_Time,Local_X,Local_Y,Global_X,Global_Y,v_length,v_Width,v_Class,v_Vel,"
    "v_Acc,Lane_ID,O_Zone,D_Zone,Int_ID,Section_ID,Direction,Movement,Preceding,Following,Space_Headway,Time_Headway,"
    "Location"
)
PORTAL_COLUMNS = (*STREET_COLUMNS[:14], *URBAN, *STREET_COLUMNS[-4:], "location")
LANE_WIDTH = 3.66  # [m]
STRETCH = 640.0  # [m] of road
HEADWAY = 2.6  # [s] mean between vehicles of a lane
LEAD_IN_MS = 60_000  # a clock starts about this long before its period
WHOLE_NAMES = (
    "vehicle_id",
    "frame",
    "total_frames",
    "time_ms",
    "vehicle_class",
    "lane",
    "preceding",
    "following",
    *URBAN,
)


def table(
    site: Site = US101, period: str = "0750", rows_wanted: int = 2000, *, noise: float = 0.05, seed: int = 0
) -> pd.DataFrame:
    """About as many rows as wanted of one recording, in the units and axes of the files (feet, State Plane).

    Columns are called as in ``ngsim.formats.NAMES``. Vehicles of a lane share their speed at any time, a slow wave, and
    so never touch. `noise` is the standard deviation of a position [m], constant over half a second each.
    """
    rng = np.random.default_rng(seed)
    lanes = 2 if site.urban else 5
    shares = map(len, np.array_split(np.arange(rows_wanted), lanes * (1 + site.urban)))
    pieces = [_lane(lane, rng, share) for lane, share in enumerate(shares) if share]
    rows = pd.concat(pieces, ignore_index=True)
    back = rows["lane"] >= lanes  # the other direction of a street
    lane = rows["lane"] % lanes + 1
    entered = rows.groupby(["lane", "number"])["frame"].transform("min")
    rank = pd.MultiIndex.from_arrays([entered, rows["lane"], rows["number"]])
    vehicle = pd.factorize(rank, sort=True)[0] + 1
    wobble = noise * rng.standard_normal((len(rows) // 5 + 1, 2)).repeat(5, axis=0)[: len(rows)]
    along = rows["s"].to_numpy() + wobble[:, 0]
    aside = -LANE_WIDTH * (lane.to_numpy() - 0.5) + wobble[:, 1]
    x = np.where(back, STRETCH - along, along)
    y = np.where(back, -aside + 2.0, aside)
    global_x, global_y = global_from_map(site, x, y)
    day = datetime.strptime(f"{site.date} {period}", "%Y-%m-%d %H%M").replace(tzinfo=UTC)
    origin = int(day.timestamp() * 1000) - site.utc_offset_h * 3_600_000 - LEAD_IN_MS
    frame = rows["frame"].to_numpy() + LEAD_IN_MS // 100 + 1
    truck = rng.random(vehicle.max() + 1) < 0.05
    made = pd.DataFrame(
        {
            "vehicle_id": vehicle,
            "frame": frame,
            "total_frames": pd.Series(vehicle).groupby(vehicle).transform("size"),
            "time_ms": origin + 100 * frame,
            "local_x": np.abs(y) / FOOT,
            "local_y": x / FOOT,
            "global_x": global_x / FOOT,
            "global_y": global_y / FOOT,
            "length": np.where(truck, 36.0, 14.5)[vehicle],
            "width": np.where(truck, 8.2, 6.4)[vehicle],
            "vehicle_class": np.where(truck, 3, 2)[vehicle],
            "speed": rows["speed"] / FOOT,
            "acceleration": rows["acceleration"] / FOOT,
            "lane": lane,
            "o_zone": 101,
            "d_zone": 203,
            "intersection": 0,
            "section": 1,
            "direction": np.where(back, 4, 2),
            "movement": 1,
            "preceding": 0,
            "following": 0,
            "space_headway": 0.0,
            "time_headway": 9999.99,
            "location": site.location,
        }
    )
    made = made.round(dict.fromkeys(["local_x", "local_y", "global_x", "global_y"], 3))
    made = made.round(dict.fromkeys(["speed", "acceleration"], 2))
    return made.sort_values(["vehicle_id", "frame"], ignore_index=True)


def global_from_map(site: Site, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frame map (n,) [m] to State Plane metres (n,): the inverse of ``Site.map_from_global``."""
    cos, sin = np.cos(site.yaw), np.sin(site.yaw)
    dx, dy = x - site.map_anchor[0], y - site.map_anchor[1]
    return site.global_anchor[0] + cos * dx + sin * dy, site.global_anchor[1] - sin * dx + cos * dy


def _lane(lane: int, rng: np.random.Generator, rows: int) -> pd.DataFrame:
    """Frames of the vehicles of one lane until there are `rows`: lane, number, frame, s [m], speed, acceleration."""
    phase, period = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(50.0, 70.0)
    frames = 4 * int(STRETCH / 10.0 / STEP_S) + int(rows * HEADWAY / (STRETCH / 10.0))
    time = STEP_S * np.arange(frames)
    angle = 2.0 * np.pi * time / period + phase
    speed, acceleration = 10.0 + 4.0 * np.sin(angle), 4.0 * 2.0 * np.pi / period * np.cos(angle)
    way = 10.0 * time - 4.0 * period / (2.0 * np.pi) * (np.cos(angle) - np.cos(phase))
    pieces, enters, left, number = [], int(rng.integers(0, 20)), rows, 0
    while left > 0:
        leaves = int(np.searchsorted(way, way[enters] + STRETCH))
        index = np.arange(enters, min(leaves, enters + left))
        pieces.append(np.column_stack([np.full(len(index), number), index, way[index] - way[enters]]))
        left, number = left - len(index), number + 1
        enters += round((HEADWAY + rng.exponential(0.2)) / STEP_S)
    done = np.concatenate(pieces)
    index = done[:, 1].astype(np.int64)
    return pd.DataFrame(
        {
            "lane": lane,
            "number": done[:, 0].astype(np.int64),
            "frame": index,
            "s": done[:, 2],
            "speed": speed[index],
            "acceleration": acceleration[index],
        }
    )


def write_text(made: pd.DataFrame, path: Path) -> Path:
    """`path`, written as the whitespace text of motorways (18 columns) or streets (24)."""
    columns = STREET_COLUMNS if _has_streets(made) else MOTORWAY_COLUMNS
    texts = [[f"{value:.{_decimals(name)}f}" for value in made[name]] for name in columns]
    path.write_text("".join(f"  {'  '.join(line)} \n" for line in zip(*texts, strict=True)), encoding="ascii")
    return path


def write_portal(made: pd.DataFrame, path: Path, *, commas: bool = True) -> Path:
    """`path`, written as the portal's CSV (25 columns); with `commas`, "1,118,847,869,000" as it has large numbers."""
    given = made[[*PORTAL_COLUMNS]].copy()
    if not _has_streets(made):
        given[[*URBAN]] = None
    if commas:
        for name in ("vehicle_id", "frame", "total_frames", "time_ms", "global_x", "global_y", "local_y"):
            given[name] = [f"{value:,.{_decimals(name)}f}" for value in made[name]]
    given.to_csv(path, header=PORTAL_HEADER.split(","), index=False)
    return path


def _has_streets(made: pd.DataFrame) -> bool:
    return bool(made["location"].isin(["lankershim", "peachtree"]).any())


def _decimals(name: str) -> int:
    return 0 if name in WHOLE_NAMES else 3
