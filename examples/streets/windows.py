"""Scenarios of windows of Lankershim Boulevard and Peachtree Street: ``python examples/streets/windows.py OUT``.

Needs the data that LITSIM_DATA names (CommonRoad's windows of NGSIM and their maps). Windows of one junction have
frames and clocks of their own: each is moved onto the map. On Lankershim, a timing plan is set to what vehicles do.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
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
PLAN = HERE / "lankershim.yaml"
MAPS = {"lankershim": "USA_Lanker-2_25", "peachtree": "USA_Peach-4_2", "peachtree_north": "USA_Peach-2_1"}
"""CommonRoad's maps by net; those of Lankershim show the same junction."""


@dataclass(frozen=True)
class Window:
    """A recording made of windows of one street.

    Attributes:
        parts: by window, as CommonRoad names it, the frame at which it begins, and where it lies on the map: x, y [m].
        reported: whether runs on it are reported, or plan and parameters may be chosen by it.
        net: on which it lies; a key of MAPS.
    """

    parts: dict[str, tuple[int, float, float]]
    reported: bool
    net: str = "lankershim"


CHOSEN = {
    "a": Window({"Lanker-2_4": (0, 24.7, 66.5)}, reported=False),
    "b": Window({"Lanker-2_10": (0, 24.0, 92.5)}, reported=False),
    "c": Window({"Lanker-2_11": (0, 42.0, 100.0)}, reported=False),
    "d": Window({"Lanker-2_13": (0, 16.0, 75.0), "Lanker-2_14": (20, 23.25, 69.79)}, reported=False),
    "peachtree_north": Window({"Peach-2_1": (0, 0.0, 0.0)}, reported=False, net="peachtree_north"),
    "through": Window(
        {"Lanker-2_16": (0, 2.9, 4.9), "Lanker-2_19": (75, 32.0, 100.0), "Lanker-2_21": (130, 35.4, 50.5)},
        reported=True,
    ),
    "side": Window({"Lanker-2_17": (0, 11.5, 8.0)}, reported=True),
    "lead": Window({"Lanker-2_20": (0, 33.5, 104.5)}, reported=True),
    "both": Window({"Lanker-2_25": (0, 0.0, 0.0)}, reported=True),
    "peachtree": Window({"Peach-4_2": (0, 0.0, 0.0)}, reported=True, net="peachtree"),
}
MAPPING = {
    "source": "NGSIM, windows as published by CommonRoad",
    "licence": "CC BY-SA",
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
STREETS = ("lankershim", "peachtree")
CUT = ["--history", "1", "--simulation", "20", "--ego-min", "5", "--split", "1", "0", "0", "--stride", "30"]


def joined(table: pd.DataFrame, window: Window) -> pd.DataFrame:
    """The rows of a window's parts in one clock and in the frame of the map."""
    pieces = []
    for name, (frame, x, y) in window.parts.items():
        part = table[table["scenario"] == f"USA_{name}"]
        pieces.append(part.assign(frame=part["frame"] + frame, x_m=part["x_m"] + x, y_m=part["y_m"] + y))
    return pd.concat(pieces).drop_duplicates(["vehicle_id", "frame"])


def convert(name: str, window: Window, table: pd.DataFrame, out: Path) -> Path:
    """Write the recording of a window, with the signals of its plan where there is one, and return its file."""
    rows, mapping, made = (out / f"{name}{ending}" for ending in (".raw.parquet", ".mapping.yaml", ".parquet"))
    joined(table, window).to_parquet(rows)
    described = {"name": name, "net": f"{window.net}.net.xml"} | MAPPING
    mapping.write_text(yaml.safe_dump(described))
    data(["convert", "--mapping", str(mapping), str(rows), str(made)])
    if window.net != "lankershim":
        return made
    plan = read_yaml(PLAN, SignalsFile)
    frames = int(Recording.read(made).table["frame"].max()) + 1
    links = read_links(out / str(described["net"]))
    fit = fit_offset(plan, links, Log.from_recording(Recording.read(made), 0, frames))
    print(f"plan       {fit}")
    moved = on_clock(plan, -fit.offset_s).model_dump(mode="json", exclude_none=True)
    (out / f"{name}.signals.yaml").write_text(yaml.safe_dump(moved))
    mapping.write_text(yaml.safe_dump(described | {"signals": f"{name}.signals.yaml"}))
    data(["convert", "--mapping", str(mapping), str(rows), str(made)])
    return made


def write_apart(names: Sequence[str], others: Sequence[str], out: Path) -> None:
    """Write recordings to train on, as NAME_train.parquet: `names` without the vehicles that are in `others`, too."""
    elsewhere = np.concatenate([Recording.read(out / f"{name}.parquet").table["vehicle_id"] for name in others])
    for name in names:
        whole = Recording.read(out / f"{name}.parquet")
        apart = whole.table[~whole.table["vehicle_id"].isin(elsewhere)]
        Recording.from_table(whole.header, apart, name).write(out / f"{name}_train.parquet")


def main() -> None:
    """Write nets, recordings and scenarios, and say how the plan fits."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, help="also generate eight segments of street, by this seed")
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    if arguments.seed is not None:
        generated = ["--net", "urban_like", "--segments", "8", "--seed", str(arguments.seed)]
        data(["synthesize", *generated, "--out", str(out / "generated")])
    source = Path(os.environ["LITSIM_DATA"])
    for net, name in MAPS.items():
        data(
            [
                "map",
                "--commonroad",
                str(source / f"maps/commonroad/{name}_map.xml"),
                "--out",
                str(out / f"{net}.net.xml"),
            ]
        )
    table = pd.concat([pd.read_parquet(source / f"ngsim/{street}_commonroad_windows.parquet") for street in STREETS])
    made = {name: str(convert(name, window, table, out)) for name, window in CHOSEN.items()}
    for part, reported in (("tuning", False), ("reported", True)):
        files = [made[name] for name, window in CHOSEN.items() if window.reported == reported]
        data(["segments", *files, "--out", str(out / part), *CUT])
    write_apart(["a", "c"], ["d", *(name for name, window in CHOSEN.items() if window.reported)], out)


if __name__ == "__main__":
    main()
