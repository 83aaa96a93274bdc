"""Traffic of any number of vehicles that benchmarks run on."""

from __future__ import annotations

import numpy as np
import pandas as pd

from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.scenario.recording import Recording, RecordingHeader

LANES = 5
LANE_WIDTH = 3.66  # [m]
SPACING = 10.0  # [m] between vehicles of a lane
SPEED = 8.0  # [m/s]
SIZE = (4.5, 1.8)  # [m]


def columns_of_traffic(agents: int, seconds: float, first_id: int = 1) -> Recording:
    """A recording of `agents` vehicles in five lanes, all at 8 m/s and 10 m apart, for `seconds` [s].

    They are on the net of the demo; the ids go up from `first_id`, lane by lane and then back along the road.
    """
    frames = round(seconds / STEP_S) + 1
    number = np.arange(agents)
    x0 = 15.0 + SPACING * (number // LANES) + 2.0 * (number % LANES)
    y0 = -LANE_WIDTH * (number % LANES + 0.5)
    frame, vehicle = (grid.ravel() for grid in np.meshgrid(np.arange(frames), number, indexing="ij"))
    table = pd.DataFrame({"vehicle_id": vehicle + first_id, "frame": frame})
    table["x"] = x0[vehicle] + SPEED * STEP_S * frame
    table["y"] = y0[vehicle]
    table["yaw"] = table["acceleration"] = 0.0
    table["speed"] = SPEED
    table["length"], table["width"] = SIZE
    table["kind"] = int(Kind.CAR)
    table["lane"] = vehicle % LANES + 1
    return Recording.from_table(RecordingHeader("columns", source="generated for the benchmark"), table, "benchmark")
