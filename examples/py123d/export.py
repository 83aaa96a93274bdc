"""Writes logs of py123d as files that `litsim data import` reads: boxes, lanes around, and what lights showed.

Run it in the environment that setup.sh makes: .venv/bin/python export.py DATA OUT, where DATA is PY123D_DATA_ROOT, in
which `py123d-conversion` has put logs and maps, or a folder of it.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from py123d.api.scene.arrow.arrow_scene_api import ArrowSceneAPI
from py123d.datatypes import LaneType, MapLayer

AROUND = 150.0  # [m] of the way of the recording vehicle: lanes farther away are left out
COLOURS = {"GREEN": "green", "YELLOW": "amber", "RED": "red", "OFF": "off"}
COLUMNS = {
    "vehicle_id": pa.string(),
    "time_us": pa.int64(),
    **dict.fromkeys(("x", "y", "z", "yaw", "length", "width"), pa.float64()),
    "label": pa.string(),
    "general": pa.string(),
}
"""Box centres in the frame of the data set [m], [rad]; the label of the data set, and py123d's own for all sets."""


def row(box: Any, time_us: int) -> tuple[Any, ...]:
    """Returns the columns of a box."""
    centre, own = box.center_se2, box.bounding_box_se3
    label, general = box.attributes.label.name.lower(), box.attributes.default_label.name.lower()
    place = float(centre.x), float(centre.y), float(own.center_se3.z), float(centre.yaw)
    return (str(box.attributes.track_token), time_us, *place, float(own.length), float(own.width), label, general)


def seen(scene: ArrowSceneAPI) -> tuple[list[tuple[Any, ...]], str | None, list[tuple[int, str, str]]]:
    """Returns the rows of all boxes, the id of the recording vehicle, and changes of lights: time [us], lane, state."""
    rows, recorder, changes, last = [], None, [], dict[str, str]()
    for at in range(scene.number_of_iterations):
        if (ego := scene.get_ego_state_se3_at_iteration(at)) is not None:
            rows.append(row(ego.box_detection_se3, ego.timestamp.time_us))
            recorder = rows[-1][0]
        if (boxes := scene.get_box_detections_se3_at_iteration(at)) is not None:
            rows += [row(box, boxes.timestamp.time_us) for box in boxes]
        if (lights := scene.get_traffic_light_detections_at_iteration(at)) is not None:
            shown = {str(one.lane_id): COLOURS.get(one.status.name, "unknown") for one in lights}
            for lane in sorted({*shown, *last}):
                state = shown.get(lane, "unknown")
                if state != last.get(lane):
                    changes.append((lights.timestamp.time_us, lane, state))
                last[lane] = state
    return rows, recorder, changes


def lanes(scene: ArrowSceneAPI, way: list[tuple[float, float]]) -> list[dict[str, Any]]:
    """Returns the lanes of vehicles around `way`, the places of the recording vehicle; none without a map."""
    api = scene.get_map_api()
    if api is None or not way:
        return []
    area = (shapely.LineString(way) if len(way) > 1 else shapely.Point(way[0])).buffer(AROUND)
    near = api.query(area, [MapLayer.LANE], predicate="intersects")[MapLayer.LANE]
    return [
        {
            "id": str(lane.object_id),
            "left": lane.left_boundary.array.tolist(),
            "right": lane.right_boundary.array.tolist(),
            "predecessors": [str(one) for one in lane.predecessor_ids],
            "successors": [str(one) for one in lane.successor_ids],
            "left_id": None if lane.left_lane_id is None else str(lane.left_lane_id),
            "right_id": None if lane.right_lane_id is None else str(lane.right_lane_id),
            "speed_limit": lane.speed_limit_mps,
            "junction": lane.lane_group is not None and lane.lane_group.intersection_id is not None,
            "bicycles": lane.lane_type == LaneType.BIKE_LANE,
        }
        for lane in near
    ]


def export(log: Path, maps: Path, out: Path) -> str:
    """Writes the log in folder `log` into folder `out`; returns a line on it."""
    scene = ArrowSceneAPI(log, maps_root=maps)
    rows, recorder, changes = seen(scene)
    if not rows:
        return f"{log}: holds neither boxes nor the recording vehicle, and is left out"
    around = lanes(scene, [(one[2], one[3]) for one in rows if one[0] == recorder])
    content = {"dataset": scene.dataset, "log": scene.log_name, "ego": recorder, "lanes": around, "lights": changes}
    columns = zip(COLUMNS.items(), zip(*rows, strict=True), strict=True)
    table = pa.table({name: pa.array(values, kind) for (name, kind), values in columns})
    path = out / f"{re.sub(r'[^A-Za-z0-9_+=-]', '_', f'{scene.dataset}_{scene.log_name}')}.parquet"
    pq.write_table(table.replace_schema_metadata({"py123d": json.dumps(content)}), path, compression="zstd")
    lit = len({lane for _, lane, _ in changes})
    return f"{path}: {len(rows)} rows, {len({one[0] for one in rows})} tracks, {len(around)} lanes, {lit} lights"


def main() -> None:
    """Writes all logs of the folder that is named."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("data", type=Path, help="folder with the logs of py123d: PY123D_DATA_ROOT, or one in it")
    parser.add_argument("out", type=Path, help="folder that gets a file for each log")
    parser.add_argument(
        "--maps", type=Path, help="folder of the maps; by default DATA/maps, then PY123D_DATA_ROOT/maps"
    )
    asked = parser.parse_args()
    logs = sorted(file.parent for file in asked.data.rglob("sync.arrow"))
    if not logs:
        sys.exit(f"export.py: {asked.data}: holds no log of py123d (sync.arrow); `py123d-conversion` makes them")
    asked.out.mkdir(parents=True, exist_ok=True)
    for log in logs:
        print(export(log, asked.maps or asked.data / "maps", asked.out), flush=True)


if __name__ == "__main__":
    main()
