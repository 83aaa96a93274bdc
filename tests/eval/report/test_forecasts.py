"""Forecasts are read from a bag by the definitions that it holds, thinned, and without those that say nothing."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from litsim_eval.report.forecasts import FORECASTS, POINTS_MAX, read_forecasts
from litsim_sim.core.errors import InputError
from litsim_sim.record.bag import BagTopic, BagWriter, qos_yaml
from litsim_sim.record.run import Run

DEFINITION = Path(__file__).resolve().parents[3] / "src/litsim_msgs/msg/JointForecast.msg"
KIND = "litsim_msgs/msg/JointForecast"
POINTS = 25


def message(types: Any, run_id: str, step: int, **changes: Any) -> Any:
    """Of agents 4 and 2; the k-th point is at x = agent + k."""
    ids = np.array([4, 2])
    k = np.arange(POINTS)
    mean = np.stack(np.broadcast_arrays(ids[:, None] + k, float(step)), axis=-1).astype(np.float64)
    spread = np.full((2, POINTS, 3), 0.25, np.float32)
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    usual = {
        "header": types["std_msgs/msg/Header"](stamp=stamp, frame_id="map"),
        "run_id": run_id,
        "step": step,
        "dt": 0.2,
        "horizon": 5.0,
        "id": ids,
        "mean": mean.ravel(),
        "yaw": np.zeros(2 * POINTS, np.float32),
        "covariance": spread.ravel(),
        "maneuver_probability": np.empty(0, np.float32),
        "valid": np.ones(2, np.bool_),
        "mode_row": np.empty(0, np.uint32),
        "mode_probability": np.empty(0, np.float32),
        "mode_mean": np.empty(0),
        "mode_yaw": np.empty(0, np.float32),
        "mode_covariance": np.empty(0, np.float32),
    }
    return types[KIND](**(usual | changes))


@pytest.fixture
def write(small_run: Run, tmp_path: Path) -> Any:
    """Writes messages as a bag and gives the run that they belong to."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(DEFINITION.read_text(), KIND))

    def write_bag(*described: dict[str, Any]) -> Run:
        with BagWriter(tmp_path / "bag", "made") as writer:
            definition = store.generate_msgdef(KIND, ros_version=2)[0]
            writer.add_topic(BagTopic(FORECASTS, KIND, definition, qos_yaml(10), store.hash_rihs01(KIND)))
            for values in described:
                made = message(store.types, **({"run_id": small_run.info.run_id} | values))
                writer.write(FORECASTS, bytes(store.serialize_cdr(made, KIND)), values["step"] * 100_000_000)
        return replace(small_run, path=tmp_path / "bag/made_0.mcap")

    return write_bag


def test_read(write: Any) -> None:
    found = read_forecasts(write({"step": 5}, {"step": 6}))
    assert found.agent.tolist() == [2, 2, 4, 4]
    assert found.step.tolist() == [5, 6, 5, 6]
    assert len(found.time) == POINTS_MAX
    assert found.time[[0, -1]] == pytest.approx([0.2, 5.0])
    assert found.mean[1, [0, 1, -1]].tolist() == [[2.0, 6.0], [4.0, 6.0], [26.0, 6.0]]
    assert found.every(2).step.tolist() == [6, 6]


def test_what_is_not_of_this_run_or_not_valid_is_left_out(write: Any) -> None:
    bad = np.zeros(4 * POINTS)
    bad[0] = np.nan
    found = read_forecasts(
        write(
            {"step": 1, "run_id": "another"},
            {"step": 2, "valid": np.array([False, True])},
            {"step": 3, "mean": bad},
            {"step": 3},
            {"step": 4, "id": np.empty(0, np.int64), "mean": np.empty(0)},
        )
    )
    assert list(zip(found.agent.tolist(), found.step.tolist(), strict=True)) == [(2, 2), (2, 3)]


def test_none(write: Any) -> None:
    found = read_forecasts(write())
    assert len(found) == 0


def test_arrays_that_do_not_fit_are_said(write: Any) -> None:
    with pytest.raises(InputError, match="forecasts"):
        read_forecasts(write({"step": 1, "covariance": np.zeros(7, np.float32)}))
