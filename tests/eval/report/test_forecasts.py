"""Forecasts are read from a bag by the definitions that it holds, thinned, and without those that say nothing."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from litsim_msgs.msg import JointForecast
from rclpy.serialization import serialize_message

from litsim_eval.report.forecasts import POINTS_MAX, read_forecasts
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_NS
from litsim_sim.record.bag import BagWriter
from litsim_sim.record.run import Run
from litsim_sim.ros.cdr import without_padding
from litsim_sim.ros.messages import header, to_array
from litsim_sim.ros.topics import FORECASTS

POINTS = 25


def message(run_id: str, step: int, **changes: Any) -> JointForecast:
    """Of agents 4 and 2; the k-th point is at x = agent + k."""
    ids = np.array([4, 2])
    mean = np.stack(np.broadcast_arrays(ids[:, None] + np.arange(POINTS), float(step)), axis=-1).astype(np.float64)
    spread, yaw = np.full((2, POINTS, 3), 0.25, np.float32), np.zeros(2 * POINTS, np.float32)
    valid = changes.pop("valid", [True, True])
    arrays = {"id": ids, "mean": mean, "yaw": yaw, "covariance": spread} | changes
    columns = {name: to_array(values) for name, values in arrays.items()}
    return JointForecast(header=header(0), run_id=run_id, step=step, dt=0.2, horizon=5.0, valid=valid, **columns)


@pytest.fixture
def write(small_run: Run, tmp_path: Path) -> Any:
    """Writes messages as a bag and gives the run that they belong to."""

    def write_bag(*described: dict[str, Any]) -> Run:
        with BagWriter(tmp_path / "bag", "made") as writer:
            writer.add_topic(FORECASTS.described)
            for values in described:
                made = serialize_message(message(**({"run_id": small_run.info.run_id} | values)))
                writer.write(FORECASTS.name, without_padding(JointForecast)(made), values["step"] * STEP_NS)
        return replace(small_run, path=tmp_path / "bag/made_0.mcap", info=replace(small_run.info, mode="lockstep"))

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
            {"step": 2, "valid": [False, True]},
            {"step": 3, "mean": bad},
            {"step": 3},
            {"step": 4, "id": np.empty(0, np.int64), "mean": np.empty(0)},
        )
    )
    assert list(zip(found.agent.tolist(), found.step.tolist(), strict=True)) == [(2, 2), (2, 3)]


def test_none(write: Any) -> None:
    assert len(read_forecasts(write()).agent) == 0


def test_arrays_that_do_not_fit_are_said(write: Any) -> None:
    with pytest.raises(InputError, match="forecasts"):
        read_forecasts(write({"step": 1, "covariance": np.zeros(7, np.float32)}))
