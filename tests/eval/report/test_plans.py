"""What the ego's stack has planned is read from a bag by the definitions in it."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from litsim_eval.report.plans import AUTOWARE, NO_PLANS, PATH, POINTS_MAX, read_plans
from litsim_sim.record.bag import BagTopic, BagWriter, qos_yaml
from litsim_sim.record.run import Run
from litsim_sim.scenario.run_info import EXTERNAL
from made_bags import Messages

TOPIC = "/planning/trajectory"
# Those fields of Autoware's types that are read: a bag may hold another version of them.
POINT = "geometry_msgs/Pose pose\nfloat32 longitudinal_velocity_mps\n"
PLAN = f"std_msgs/Header header\nautoware_planning_msgs/TrajectoryPoint[] points\n{'=' * 80}\n"
PLAN += f"MSG: autoware_planning_msgs/TrajectoryPoint\n{POINT}"


@pytest.fixture
def write(small_run: Run, tmp_path: Path) -> Any:
    """Writes plans (step, points, speeds) as a bag, and gives the run that they belong to."""
    types = Messages("made_msgs")
    types.store.register(get_types_from_msg(PLAN, AUTOWARE))

    def pose(x: float, y: float) -> Any:
        return types.make("geometry_msgs/msg/Pose", position=types.make("geometry_msgs/msg/Point", x=x, y=y))

    def write_bag(kind: str, *plans: tuple[int, list[tuple[float, float]], list[float]]) -> Run:
        with BagWriter(tmp_path / "bag", "made") as writer:
            definition = types.store.generate_msgdef(kind, ros_version=2)[0]
            writer.add_topic(BagTopic(TOPIC, kind, definition, qos_yaml(1), ""))
            for step, places, speeds in plans:
                if kind == PATH:
                    stamped = [types.make("geometry_msgs/msg/PoseStamped", pose=pose(*at)) for at in places]
                    message = types.make(kind, poses=stamped)
                else:
                    point = partial(types.make, "autoware_planning_msgs/msg/TrajectoryPoint")
                    both = zip(places, speeds, strict=True)
                    message = types.make(
                        kind, points=[point(pose=pose(*at), longitudinal_velocity_mps=v) for at, v in both]
                    )
                writer.write(TOPIC, bytes(types.store.serialize_cdr(message, kind)), step * 100_000_000)
        return replace(small_run, path=tmp_path / "bag/made_0.mcap", info=replace(small_run.info, ego=EXTERNAL))

    return write_bag


def test_plans_end_where_they_stand(write: Any) -> None:
    line = [(float(k), 2.0) for k in range(5)]
    early, late = (3, line, [0.0, 4.0, 2.0, 0.0, 0.0]), (5, line, [4.0] * 5)  # it starts from rest, and stops
    found = read_plans(write(AUTOWARE, (3, line[:2], [1.0, 1.0]), early, late))
    assert (found.topic, found.step.tolist(), found.end.tolist(), found.stop.tolist()) == (
        TOPIC,
        [3, 5],
        [4, 9],
        [1, 0],
    )
    assert found.place[:4].tolist() == [list(place) for place in line[:4]]


def test_long_paths_are_thinned(write: Any) -> None:
    found = read_plans(write(PATH, (3, [(0.5 * k, 0.0) for k in range(401)], [])))
    assert (len(found.place), found.stop.tolist()) == (POINTS_MAX, [0])
    assert found.place[[0, -1], 0].tolist() == [0.0, 200.0]
    assert np.all(np.diff(found.place[:, 0]) > 0.0)


def test_own_egos_have_none(small_run: Run) -> None:
    assert read_plans(small_run) is NO_PLANS
