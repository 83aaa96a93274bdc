"""Made-up traffic in NGSIM's official formats."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pcsv

from litsim_data.generic.mapping import FOOT
from litsim_data.ngsim.formats import MOTORWAY_COLUMNS, STREET_COLUMNS, URBAN
from litsim_data.ngsim.sites import Site
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


@dataclass(frozen=True)
class Traffic:
    """Specification of one recording.

    Attributes:
        site: its site.
        period: its period, such as "0750".
        rows: approximate number of rows.
        noise: standard deviation of a position [m], constant over half a second each.
        duplicated, missing: shares of rows that occur twice, and that are left out.
        seed: seed of all randomness.
    """

    site: Site
    period: str
    rows: int
    noise: float = 0.05
    duplicated: float = 0.0
    missing: float = 0.0
    seed: int = 0


def table(traffic: Traffic) -> pd.DataFrame:
    """Rows by the names of ``ngsim.formats.NAMES``, in the units and axes of the files (feet, State Plane).

    Vehicles of a lane share their speed at any time, a slow wave, and so never touch.
    """
    rng = np.random.default_rng(traffic.seed)
    site, urban = traffic.site, traffic.site.urban
    lanes = 2 if urban else 5
    shares = _shares(traffic.rows, lanes * (1 + urban))
    pieces = [_lane(lane, rng, share) for lane, share in enumerate(shares) if share]
    rows = pd.concat(pieces, ignore_index=True)
    back = rows["lane"] >= lanes  # the other direction of a street
    lane = rows["lane"] % lanes + 1
    entered = rows.groupby(["lane", "number"])["frame"].transform("min")
    rank = pd.MultiIndex.from_arrays([entered, rows["lane"], rows["number"]])
    vehicle = pd.factorize(rank, sort=True)[0] + 1
    wobble = traffic.noise * rng.standard_normal((len(rows) // 5 + 1, 2)).repeat(5, axis=0)[: len(rows)]
    along = rows["s"].to_numpy() + wobble[:, 0]
    aside = -LANE_WIDTH * (lane.to_numpy() - 0.5) + wobble[:, 1]
    x = np.where(back, STRETCH - along, along)
    y = np.where(back, -aside + 2.0, aside)
    global_x, global_y = global_from_map(site, x, y)
    day = datetime.strptime(f"{site.date} {traffic.period}", "%Y-%m-%d %H%M").replace(tzinfo=UTC)
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
    made = made.round(dict.fromkeys(["speed", "acceleration"], 2)).sort_values(["vehicle_id", "frame"])
    made = made[rng.random(len(made)) >= traffic.missing]
    again = made[rng.random(len(made)) < traffic.duplicated]
    return pd.concat([made, again], ignore_index=True)


def global_from_map(site: Site, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frame map (n,) [m] to State Plane metres (n,): the inverse of ``Site.map_from_global``."""
    cos, sin = np.cos(site.yaw), np.sin(site.yaw)
    dx, dy = x - site.map_anchor[0], y - site.map_anchor[1]
    return site.global_anchor[0] + cos * dx + sin * dy, site.global_anchor[1] - sin * dx + cos * dy


def _shares(rows: int, lanes: int) -> list[int]:
    return [rows // lanes + (lane < rows % lanes) for lane in range(lanes)]


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


def write_text(made: pd.DataFrame, path: Path) -> None:
    """Write as the whitespace text of motorways (18 columns) or streets (24)."""
    urban = bool(made["location"].isin(["lankershim", "peachtree"]).any())
    columns = STREET_COLUMNS if urban else MOTORWAY_COLUMNS
    lines = (
        "  ".join(_number(name, value) for name, value in zip(columns, row, strict=True))
        for row in made[[*columns]].itertuples(index=False)
    )
    path.write_text("".join(f"  {line} \n" for line in lines), encoding="ascii")


def _number(name: str, value: float) -> str:
    return f"{value:.0f}" if name in WHOLE_NAMES else f"{value:.3f}"


def write_portal(made: pd.DataFrame, path: Path, *, commas: bool = True) -> None:
    """Write as the portal's CSV (25 columns); with `commas`, "1,118,847,869,000" as it exports large numbers."""
    columns = {name: pa.array(made[name]) for name in PORTAL_COLUMNS}
    if not made["location"].isin(["lankershim", "peachtree"]).any():
        columns |= {name: pa.nulls(len(made), pa.string()) for name in URBAN}
    if commas:
        for name in ("vehicle_id", "frame", "total_frames", "time_ms", "global_x", "global_y", "local_y"):
            columns[name] = _with_commas(columns[name], 0 if name in WHOLE_NAMES else 3)
    options = pcsv.WriteOptions(include_header=False, quoting_style="needed")
    together = pa.table(columns).combine_chunks()  # pyarrow 23 writes rows of chunked text columns twice
    with path.open("wb") as file:
        file.write(f"{PORTAL_HEADER}\n".encode())
        pcsv.write_csv(together, file, options)


def _with_commas(values: pa.Array, decimals: int) -> pa.Array:
    """Numbers as text with a comma between thousands."""
    scaled = np.round(np.abs(values.to_numpy(zero_copy_only=False)) * 10**decimals).astype(np.int64)
    sign = pa.array(np.where(values.to_numpy(zero_copy_only=False) < 0, "-", ""))
    rest, fraction = np.divmod(scaled, 10**decimals)
    text = None
    while text is None or rest.any():
        rest, group = np.divmod(rest, 1000)
        padded = pc.utf8_lpad(pc.cast(pa.array(group), pa.string()), 3, "0")
        leading = pa.array(rest == 0)
        plain = pc.if_else(leading, pc.cast(pa.array(group), pa.string()), padded)
        if text is None:
            text = plain
        else:
            shown = pa.array((rest > 0) | (group > 0))
            text = pc.if_else(shown, pc.binary_join_element_wise(plain, text, ","), text)
    if decimals:
        digits = pc.utf8_lpad(pc.cast(pa.array(fraction), pa.string()), decimals, "0")
        text = pc.binary_join_element_wise(text, digits, ".")
    return pc.binary_join_element_wise(sign, text, "")
