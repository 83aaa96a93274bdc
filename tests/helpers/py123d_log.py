"""Writes a log and a map with py123d's own writers, in the environment of examples/py123d: CROSSING.json DATA.

CROSSING.json is `made_sources.crossing()`; DATA becomes a PY123D_DATA_ROOT.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from py123d.api.map.arrow.arrow_map_writer import ArrowMapWriter
from py123d.api.scene.arrow.arrow_log_writer import ArrowLogWriter
from py123d.api.scene.arrow.utils.log_writer_config import LogWriterConfig
from py123d.datatypes import (
    BoxDetectionAttributes,
    BoxDetectionSE3,
    BoxDetectionsSE3,
    BoxDetectionsSE3Metadata,
    EgoStateSE3,
    EgoStateSE3Metadata,
    Intersection,
    IntersectionType,
    Lane,
    LaneGroup,
    LaneType,
    LogMetadata,
    MapMetadata,
    Timestamp,
    TrafficLightDetection,
    TrafficLightDetections,
    TrafficLightStatus,
)
from py123d.geometry import BoundingBoxSE3, EulerAngles, Polyline3D, PoseSE3
from py123d.parser.base_dataset_parser import ModalitiesSync
from py123d.parser.registry import NuPlanBoxDetectionLabel

BEGIN_US = 1_600_000_000_000_000
LABELS = {"car": NuPlanBoxDetectionLabel.VEHICLE, "pedestrian": NuPlanBoxDetectionLabel.PEDESTRIAN}
BEHIND = 1.4  # [m] the rear axle behind the middle of the recording vehicle


def pose(x: float, y: float, yaw: float) -> PoseSE3:
    quaternion = EulerAngles(roll=0.0, pitch=0.0, yaw=yaw).quaternion
    return PoseSE3(x, y, 0.0, quaternion.qw, quaternion.qx, quaternion.qy, quaternion.qz)


def frame(rows: list[dict[str, Any]], lit: int, recorder: int, time: Timestamp) -> ModalitiesSync:
    (own,) = (row for row in rows if row["id"] == recorder)
    middle = PoseSE3(BEHIND, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    vehicle = EgoStateSE3Metadata("made", own["width"], own["length"], 1.6, 2.8, middle, PoseSE3.identity())
    rear = pose(own["x"] - BEHIND * np.cos(own["yaw"]), own["y"] - BEHIND * np.sin(own["yaw"]), own["yaw"])
    boxes = [
        BoxDetectionSE3(
            BoxDetectionAttributes(LABELS[row["kind"]], str(row["id"])),
            BoundingBoxSE3(pose(row["x"], row["y"], row["yaw"]), row["length"], row["width"], 1.6),
        )
        for row in rows
        if row is not own
    ]
    seen = BoxDetectionsSE3(boxes, time, BoxDetectionsSE3Metadata(NuPlanBoxDetectionLabel))
    light = TrafficLightDetections([TrafficLightDetection(lit, TrafficLightStatus.GREEN)], time)
    return ModalitiesSync(time, [EgoStateSE3.from_rear_axle(rear, vehicle, time), seen, light])


def main(crossing: dict[str, Any], data: Path) -> None:
    metadata = MapMetadata("nuplan", "made", map_has_z=True, map_is_per_log=False)
    lanes = ArrowMapWriter(force_map_conversion=True, maps_root=data / "maps", logs_root=data / "logs")
    lanes.reset(metadata)
    for lane in crossing["lanes"]:
        left, right = (np.array(lane[side]) for side in ("left", "right"))
        sides = Polyline3D.from_array(left), Polyline3D.from_array(right)
        middle = Polyline3D.from_array(0.5 * (left + right))
        links = {"predecessor_ids": lane["before"], "successor_ids": lane["after"]}
        kind = LaneType.BIKE_LANE if lane["bicycles"] else LaneType.SURFACE_STREET
        group = 100 + lane["id"]
        lanes.write_map_object(Lane(lane["id"], kind, *sides, middle, lane_group_id=group, **links))
        inside = 200 if lane["inside"] else None
        lanes.write_map_object(LaneGroup(group, [lane["id"]], *sides, intersection_id=inside))
    groups = [100 + lane["id"] for lane in crossing["lanes"] if lane["inside"]]
    outline = Polyline3D.from_array(
        np.array([[-10, -10, 20], [10, -10, 20], [10, 10, 20], [-10, 10, 20], [-10, -10, 20.0]])
    )
    lanes.write_map_object(Intersection(200, IntersectionType.TRAFFIC_LIGHT, groups, outline))
    lanes.close()
    tracks = crossing["tracks"]
    rows = [dict(zip(tracks, values, strict=True)) for values in zip(*tracks.values(), strict=True)]
    log = ArrowLogWriter(LogWriterConfig(force_log_conversion=True), data / "logs", data / "sensors")
    log.reset(LogMetadata("nuplan", "nuplan_mini_val", "made", "made", metadata))
    for step in range(max(tracks["step"]) + 1):
        time = Timestamp.from_us(BEGIN_US + 100_000 * step)
        log.write_sync(frame([row for row in rows if row["step"] == step], crossing["lit"], crossing["recorder"], time))
    log.close()


if __name__ == "__main__":
    main(json.loads(Path(sys.argv[1]).read_text()), Path(sys.argv[2]))
