"""One pair at a time as the arrays of geometry have it, to the last bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_sim.core.geometry import boxes_overlap, wrap_angle
from litsim_sim.core.pair_geometry import behind_scene, overlap, within, within_scenes, wrapped


def test_overlap_is_that_of_arrays() -> None:
    random = np.random.default_rng(0)
    dx, dy = random.uniform(-6.0, 6.0, (2, 5000))
    yaw_a, yaw_b = random.uniform(-7.0, 7.0, (2, 5000))
    sizes = random.uniform(0.5, 8.0, (4, 5000))
    expected = boxes_overlap(dx, dy, yaw_a, yaw_b, (sizes[0], sizes[1]), (sizes[2], sizes[3]))
    found = [overlap(*values) for values in zip(dx, dy, yaw_a, yaw_b, *sizes, strict=True)]
    assert 500 < expected.sum() < 4500
    assert found == expected.tolist()


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_are_those_of_arrays(angle: float) -> None:
    assert wrapped(angle) == wrap_angle(np.array([angle]))[0]


def test_the_ends_of_the_half_open_turn() -> None:
    for turn in range(-5, 6):
        near = turn * np.pi + np.spacing(turn * np.pi) * np.arange(-20, 21)
        assert [wrapped(angle) for angle in near] == wrap_angle(near).tolist()


@given(*(st.floats(-10.0, 10.0) for _ in range(3)))
def test_within_cuts_as_numpy_does(value: float, low: float, high: float) -> None:
    assert within(value, low, high) == np.clip(value, low, high)


@pytest.mark.parametrize("value", [-1.0, -0.0, 0.0, 1.0])
@pytest.mark.parametrize("low", [-0.0, 0.0])
@pytest.mark.parametrize("high", [-0.0, 0.0])
def test_within_keeps_the_sign_of_zero_that_numpy_gives(value: float, low: float, high: float) -> None:
    found, expected = within(value, low, high), np.clip(*np.full((3, 1), [[value], [low], [high]]))[0]
    assert found == expected and np.signbit(found) == np.signbit(expected)


def test_a_scene_is_a_range_of_rows() -> None:
    scene, rows = np.array([0, 0, 2, 2, 2, 5]), np.array([3, 0, 5])
    begin, end = within_scenes(scene, rows)
    assert begin.tolist() == [2, 0, 5] and end.tolist() == [5, 2, 6]
    assert [behind_scene(scene, row) for row in range(6)] == [2, 2, 5, 5, 5, 6]
