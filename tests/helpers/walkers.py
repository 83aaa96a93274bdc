"""A pedestrian that crosses the embedded motorway and a cyclist beside it, as a recording and a scenario."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import packaged

PEDESTRIAN, CYCLIST = 9001, 9002
CROSSING_X, WALKS = 420.0, 1.4  # [m] where the pedestrian crosses, [m/s] how fast


def track(agent: int, kind: Kind, x: np.ndarray, y: np.ndarray, size: tuple[float, float]) -> pd.DataFrame:
    """An agent that goes straight on at one speed, from frame 0 on."""
    dx, dy = x[1] - x[0], y[1] - y[0]
    pose = {"yaw": float(np.arctan2(dy, dx)), "speed": float(np.hypot(dx, dy)) / STEP_S, "acceleration": 0.0}
    given = {"vehicle_id": agent, "frame": np.arange(len(x)), "x": x, "y": y, "kind": int(kind), "lane": -1}
    return pd.DataFrame(given | pose | {"length": size[0], "width": size[1]})


def walking_scenario(folder: Path, frames: int = 200, **fields: object) -> Path:
    """The scenario file, with its recording beside it: the first frames of the embedded one, and both of them."""
    embedded = load_recording(packaged("scenarios/us101_like.parquet"))
    table = embedded.table[embedded.table["frame"] < frames]
    step = np.arange(frames)
    walker = track(PEDESTRIAN, Kind.PEDESTRIAN, np.full(frames, CROSSING_X), -28.0 + WALKS * STEP_S * step, (0.5, 0.5))
    rider = track(CYCLIST, Kind.BICYCLE, 150.0 + 5.0 * STEP_S * step, np.full(frames, -35.0), (1.8, 0.6))
    everybody = pd.concat([table, walker, rider], ignore_index=True)
    Recording.from_table(embedded.header, everybody, "walkers").write(folder / "walkers.parquet")
    values = {"name": "walkers", "recording": "walkers.parquet", "net": "us101_like", "ego": 7, **fields}
    (folder / "walkers.yaml").write_text(yaml.safe_dump(values))
    return folder / "walkers.yaml"
