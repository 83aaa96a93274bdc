"""Scenarios of Lankershim windows whose signals follow plan.yaml: ``python examples/lankershim/windows.py OUT``.

Needs the data that LITSIM_DATA names (CommonRoad's windows of NGSIM and their map). Windows of one junction have frames
and clocks of their own: each is moved onto the map, and the plan is set to what its vehicles do.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import yaml
from plan_offset import fit_offset

from litsim_data.cli import main as data
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.signals import SignalsFile, on_clock

HERE = Path(__file__).parent
WINDOWS, MAP = "ngsim/lankershim_commonroad_windows.parquet", "maps/commonroad/USA_Lanker-2_25_map.xml"
SITE = "USA_Lanker-"


@dataclass(frozen=True)
class Window:
    """A recording made of windows.

    Attributes:
        parts: by window, the frame at which it begins, and where it lies on the map: x, y [m].
        reported: whether runs on it are reported, or the plan was chosen by it.
    """

    parts: dict[str, tuple[int, float, float]]
    reported: bool


CHOSEN = {
    "a": Window({"2_4": (0, 24.7, 66.5)}, reported=False),
    "b": Window({"2_10": (0, 24.0, 92.5)}, reported=False),
    "c": Window({"2_11": (0, 42.0, 100.0)}, reported=False),
    "d": Window({"2_13": (0, 16.0, 75.0), "2_14": (20, 23.25, 69.79)}, reported=False),
    "through": Window({"2_16": (0, 2.9, 4.9), "2_19": (75, 32.0, 100.0), "2_21": (130, 35.4, 50.5)}, reported=True),
    "side": Window({"2_17": (0, 11.5, 8.0)}, reported=True),
    "lead": Window({"2_20": (0, 33.5, 104.5)}, reported=True),
    "both": Window({"2_25": (0, 0.0, 0.0)}, reported=True),
}
MAPPING = {
    "source": "NGSIM Lankershim, windows as published by CommonRoad",
    "licence": "CC BY-SA",
    "net": "lankershim.net.xml",
    "reference": "box_centre",
    "columns": {
        "vehicle_id": "vehicle_id",
        "frame": "frame",
        "x": "x_m",
        "y": "y_m",
        "yaw": "heading_rad",
        "speed": "speed_mps",
        "acceleration": "accel_mps2",
        "length": "length_m",
        "width": "width_m",
        "kind": "class",
    },
    "kinds": {"1": "motorcycle", "2": "car", "3": "truck"},
}


def joined(table: pd.DataFrame, window: Window) -> pd.DataFrame:
    """The rows of a window's parts in one clock and in the frame of the map."""
    pieces = []
    for name, (frame, x, y) in window.parts.items():
        part = table[table["scenario"] == SITE + name]
        pieces.append(part.assign(frame=part["frame"] + frame, x_m=part["x_m"] + x, y_m=part["y_m"] + y))
    return pd.concat(pieces).drop_duplicates(["vehicle_id", "frame"])


def main() -> None:
    """Write net, recordings and scenarios, and say how the plan fits."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    source = Path(os.environ["LITSIM_DATA"])
    net = out / str(MAPPING["net"])
    data(["map", "--commonroad", str(source / MAP), "--out", str(net)])
    table = pd.read_parquet(source / WINDOWS)
    links = read_links(net)
    plan = read_yaml(HERE / "plan.yaml", SignalsFile)
    for name, window in CHOSEN.items():
        rows, mapping, made = (out / f"{name}{ending}" for ending in (".raw.parquet", ".mapping.yaml", ".parquet"))
        joined(table, window).to_parquet(rows)
        mapping.write_text(yaml.safe_dump({"name": name} | MAPPING))
        data(["convert", "--mapping", str(mapping), str(rows), str(made)])
        frames = int(Recording.read(made).table["frame"].max()) + 1
        fit = fit_offset(plan, links, Log.from_recording(Recording.read(made), 0, frames))
        print(f"plan       {fit}")
        if window.reported:
            moved = on_clock(plan, -fit.offset_s).model_dump(mode="json", exclude_none=True)
            (out / f"{name}.signals.yaml").write_text(yaml.safe_dump(moved))
            mapping.write_text(yaml.safe_dump({"name": name, "signals": f"{name}.signals.yaml"} | MAPPING))
            data(["convert", "--mapping", str(mapping), str(rows), str(made)])
    reported = [str(out / f"{name}.parquet") for name, window in CHOSEN.items() if window.reported]
    cut = ["--history", "1", "--simulation", "20", "--ego-min", "5", "--split", "1", "0", "0", "--stride", "30"]
    data(["segments", *reported, "--out", str(out / "scenarios"), *cut])


if __name__ == "__main__":
    main()
