"""Writes the scenarios of the suite of jams: an accident ahead, a lane that is closed, a red light that stays.

    ./litsim exec python benchmarks/jam/suite.py
    ./litsim evaluate --suite examples/suites/jams.yaml

They lie in `examples/suites/jams`. 150 vehicles in five columns come to a queue: each follows the one ahead of it by
the IDM, stays in its lane, and is slow beside an accident or a closed lane. Equal files each time.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import yaml

from litsim_data.maps.netconvert import build_net
from litsim_eval.benchmark.steps import LANE_WIDTH, LANES
from litsim_policy.motion.car_following import IdmConfig, idm_acceleration
from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.io.files import make_folder
from litsim_sim.scenario.recording import Recording, RecordingHeader

FOLDER = Path(__file__).parents[2] / "examples/suites/jams"
HISTORY_S, SIMULATION_S = 3.0, 25.0
COLUMN, SPACING, SIZE = 30, 14.0, (4.5, 1.8)  # vehicles in a lane, [m] from one to the next at first, [m] of each
FOREMOST, STANDING, STOP_LINE, END = 480.0, 540.0, 600.0, 1000.0  # [m] along the road
SPEED, SLOW = 12.0, 4.0  # [m/s] of free traffic, and of traffic beside what stands in the way
BESIDE = (-60.0, 10.0)  # [m] from that, where it is slow
MODEL = IdmConfig(headway=1.0, acceleration=1.5, deceleration=2.0)
EGOS = (COLUMN + 9, 2 * COLUMN + 13, 3 * COLUMN + 7)  # in the lanes 1, 2 and 3, counted from the left from 0 on
SITUATIONS: dict[str, dict[int, float]] = {
    "accident": {1: 0.6, 2: -0.9},
    "lane_closed": {4: 0.0},
    "red_light": {},
}
"""Yaw [rad] of the vehicles that stand in the way, by lane; without any, the light is red."""


def write_net(path: Path) -> None:
    """Writes a straight road along +x with a stop line, whose left edge is at y = 0."""
    nodes, edges = ET.Element("nodes"), ET.Element("edges")
    for name, x, kind in (("begin", 0.0, "priority"), ("light", STOP_LINE, "traffic_light"), ("end", END, "priority")):
        ET.SubElement(nodes, "node", id=name, x=str(x), y="0", type=kind)
    for name, begin, end in (("approach", "begin", "light"), ("beyond", "light", "end")):
        lanes = {"numLanes": str(LANES), "width": str(LANE_WIDTH), "speed": "36", "spreadType": "right"}
        ET.SubElement(edges, "edge", {"id": name, "from": begin, "to": end, **lanes})
    build_net({"node": nodes, "edge": edges}, path, [], {})


def queue(standing: dict[int, float]) -> Iterator[pd.DataFrame]:
    """Yields each frame of the traffic, behind vehicles that stand, or behind the stop line."""
    lane, place = (grid.ravel() for grid in np.meshgrid(np.arange(LANES), np.arange(COLUMN), indexing="ij"))
    x, speed = FOREMOST - SPACING * place - 3.0 * (lane % 2), np.full(len(lane), SPEED)
    blocked = np.isin(lane, list(standing)) if standing else np.ones(len(lane), np.bool_)
    end = STANDING - SIZE[0] if standing else STOP_LINE - 0.5 * SIZE[0]  # [m] where the first of a blocked lane touches
    table = pd.DataFrame({"vehicle_id": np.arange(len(lane)) + 1, "lane": lane + 1, "y": -LANE_WIDTH * (lane + 0.5)})
    obstacles = pd.DataFrame({"vehicle_id": 901, "lane": np.array([*standing], np.int64) + 1, "x": STANDING})
    obstacles = obstacles.assign(y=-LANE_WIDTH * (obstacles.lane - 0.5), yaw=list(standing.values()))
    obstacles["vehicle_id"] += np.arange(len(obstacles))
    for frame in range(round((HISTORY_S + SIMULATION_S) / STEP_S) + 1):
        touches = np.where(place > 0, np.roll(x, 1) - SIZE[0], np.where(blocked, end, np.inf))
        leader_speed = np.where(place > 0, np.roll(speed, 1), 0.0)
        slow = ~blocked & (x > STANDING + BESIDE[0]) & (x < STANDING + BESIDE[1])
        wanted = np.where(slow, SLOW, SPEED)
        acceleration = idm_acceleration(MODEL, speed, wanted, (touches - x)[:, None], leader_speed[:, None])
        acceleration = np.maximum(acceleration, -speed / STEP_S)  # none drives back
        moving = table.assign(x=x, yaw=0.0, speed=speed, acceleration=acceleration)
        yield pd.concat([moving, obstacles.assign(speed=0.0, acceleration=0.0)]).assign(frame=frame)
        x = x + STEP_S * (speed + 0.5 * STEP_S * acceleration)
        speed = speed + STEP_S * acceleration


def main() -> None:
    """Writes net, recordings and scenarios."""
    make_folder(FOLDER)
    write_net(FOLDER / "road.net.xml")
    for name, standing in SITUATIONS.items():
        table = pd.concat(queue(standing), ignore_index=True).assign(kind=int(Kind.CAR))
        table["length"], table["width"] = SIZE
        Recording.from_table(RecordingHeader(name, source="benchmarks/jam/suite.py"), table, name).write(
            FOLDER / f"{name}.parquet"
        )
        values = {"name": name, "recording": f"{name}.parquet", "net": "road.net.xml", "history_s": HISTORY_S}
        values |= {"simulation_s": SIMULATION_S, "roi_m": 60.0, "ego": EGOS[0], "egos": [*EGOS]}
        if not standing:
            phases = [{"duration_s": 60.0, "states": {"light": "red"}}]
            values["signals"] = {"groups": {"light": ["approach"]}, "program": {"phases": phases}}
        (FOLDER / f"{name}.yaml").write_text(yaml.safe_dump(values))
    print(FOLDER)


if __name__ == "__main__":
    main()
