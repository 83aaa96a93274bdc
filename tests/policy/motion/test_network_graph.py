"""Networks of other libraries: which files drive, and what is said of others."""

from pathlib import Path

import numpy as np
import pytest

from litsim_policy.motion.network_graph import NetworkGraph
from litsim_sim.core.errors import InputError
from networks import exported


def test_an_action_is_that_of_its_own_observation_within_bounds(tmp_path: Path) -> None:
    network = NetworkGraph(exported(tmp_path / "own.onnx", 3, 0.5, -0.25, weight=0.1), 3, 2)
    seen = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, -1.0], [9.0, 9.0, 9.0]])
    assert network.actions(seen) == pytest.approx(np.array([[0.5, -0.25], [0.6, -0.15], [1.0, 1.0]]))
    assert network.actions(seen[:0]).shape == (0, 2)


@pytest.mark.parametrize(
    ("observed", "actions", "expected"),
    [
        (4, 2, r"input \S+ is refused: .*expected float32 of shape \(1, 4\)"),
        (3, 3, r"shape \(1, 2\), expected \(1, 3\)"),
    ],
)
def test_a_network_of_other_sizes_is_refused(tmp_path: Path, observed: int, actions: int, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        NetworkGraph(exported(tmp_path / "own.onnx", 3, 0.0, 0.0), observed, actions)


def test_files_that_are_no_networks_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.onnx").write_text("no network")
    for name, expected in {"none.onnx": "no such network", "text.onnx": "expected an ONNX file"}.items():
        with pytest.raises(InputError, match=expected):
            NetworkGraph(tmp_path / name, 3, 2)


def test_an_action_that_is_no_number_is_refused(tmp_path: Path) -> None:
    network = NetworkGraph(exported(tmp_path / "own.onnx", 3, 0.0, float("nan")), 3, 2)
    with pytest.raises(InputError, match="not finite"):
        network.actions(np.zeros((1, 3)))
