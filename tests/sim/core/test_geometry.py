"""Boxes and frames, against shapely and against their own inverses."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from litsim_sim.core.geometry import box_corners, boxes_overlap, overlapping_pairs, to_body, wrap_angle

AREA_UNSURE = 1e-9  # [m2] overlaps and [m] gaps below are a matter of rounding


def random_boxes(rng: np.random.Generator, count: int, spread: float) -> tuple[np.ndarray, ...]:
    """x, y, yaw, length, width of boxes of vehicle size within a square of `spread` metres."""
    x, y = rng.uniform(-0.5 * spread, 0.5 * spread, (2, count))
    return x, y, rng.uniform(-10.0, 10.0, count), rng.uniform(0.5, 20.0, count), rng.uniform(0.3, 3.0, count)


def polygons(boxes: tuple[np.ndarray, ...]) -> np.ndarray:
    """Boxes as shapely polygons, turned and shifted by shapely's own transformations."""
    out = []
    for x, y, yaw, length, width in zip(*boxes, strict=True):
        box = shapely.box(-0.5 * length, -0.5 * width, 0.5 * length, 0.5 * width)
        turned = shapely.affinity.rotate(box, yaw, origin=(0.0, 0.0), use_radians=True)
        out.append(shapely.affinity.translate(turned, x, y))
    return np.array(out)


def truth(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether the polygons share area, and whether that is beyond rounding, pair by pair."""
    area = shapely.area(shapely.intersection(a, b))
    return area > 0, (area > AREA_UNSURE) | (shapely.distance(a, b) > AREA_UNSURE)


def overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    """`boxes_overlap` of two single boxes (x, y, yaw, length, width)."""
    one, two = np.array(a)[:, None], np.array(b)[:, None]
    hit = boxes_overlap(two[0] - one[0], two[1] - one[1], one[2], two[2], (one[3], one[4]), (two[3], two[4]))
    return bool(hit[0])


# wrap_angle


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_lie_in_the_half_open_turn_and_point_the_same_way(angle: float) -> None:
    wrapped = float(wrap_angle(np.array([angle]))[0])
    assert -np.pi <= wrapped < np.pi
    turns = (angle - wrapped) / (2 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)


@pytest.mark.parametrize("turn", range(-5, 6))
def test_angles_next_to_odd_multiples_of_pi_stay_in_the_half_open_turn(turn: int) -> None:
    angles = turn * np.pi + np.spacing(turn * np.pi) * np.arange(-20, 21)
    wrapped = wrap_angle(angles)
    assert ((wrapped >= -np.pi) & (wrapped < np.pi)).all()


# box_corners


def test_corners_run_counter_clockwise_from_the_front_left() -> None:
    ahead = box_corners(*(np.array([v]) for v in (10.0, 20.0, 0.0, 4.0, 2.0)))
    assert ahead.shape == (1, 4, 2)
    assert ahead[0].tolist() == [[12.0, 21.0], [8.0, 21.0], [8.0, 19.0], [12.0, 19.0]]
    left = box_corners(*(np.array([v]) for v in (10.0, 20.0, np.pi / 2, 4.0, 2.0)))
    np.testing.assert_allclose(left[0], [[9.0, 22.0], [9.0, 18.0], [11.0, 18.0], [11.0, 22.0]], atol=1e-12)


def test_corners_agree_with_shapely_and_keep_leading_dimensions() -> None:
    boxes = random_boxes(np.random.default_rng(1), 1000, 100.0)
    corners = box_corners(*boxes)
    rings = shapely.linearrings(corners)
    assert shapely.is_ccw(rings).all()
    made, expected = shapely.polygons(rings), polygons(boxes)
    assert (shapely.hausdorff_distance(made, expected) < 1e-9).all()
    stacked = box_corners(*(b.reshape(10, 100) for b in boxes))
    assert stacked.shape == (10, 100, 4, 2)
    np.testing.assert_array_equal(stacked.reshape(1000, 4, 2), corners)


# boxes_overlap


def test_overlap_agrees_with_shapely_on_boxes_that_barely_miss_or_meet() -> None:
    rng = np.random.default_rng(3)
    a, b = random_boxes(rng, 3000, 30.0), random_boxes(rng, 3000, 30.0)
    apart = shapely.distance(polygons(a), polygons(b)) > 0.1
    a, b = tuple(v[apart] for v in a), tuple(v[apart] for v in b)
    # Move b along its shortest connection to a, up to 1 micrometre short of touching, then as far beyond it.
    ends = shapely.get_coordinates(shapely.shortest_line(polygons(b), polygons(a))).reshape(-1, 2, 2)
    way = ends[:, 1] - ends[:, 0]
    unit = way / np.hypot(way[:, 0], way[:, 1])[:, None]
    for beyond in (-1e-6, 1e-6):
        dx = b[0] + way[:, 0] + beyond * unit[:, 0] - a[0]
        dy = b[1] + way[:, 1] + beyond * unit[:, 1] - a[1]
        hit = boxes_overlap(dx, dy, a[2], b[2], (a[3], a[4]), (b[3], b[4]))
        assert (hit == (beyond > 0)).all()
        back = boxes_overlap(-dx, -dy, b[2], a[2], (b[3], b[4]), (a[3], a[4]))
        assert (back == hit).all()


def test_touching_edges_and_corners_do_not_count() -> None:
    still = (0.0, 0.0, 0.0, 4.0, 2.0)
    assert not overlap(still, (4.0, 0.0, 0.0, 4.0, 2.0))  # bumper to bumper
    assert not overlap(still, (0.0, 2.0, 0.0, 4.0, 2.0))  # side by side
    assert not overlap(still, (4.0, 2.0, 0.0, 4.0, 2.0))  # corner to corner
    assert not overlap(still, (4.0, 1.0, np.pi, 4.0, 2.0))


def test_the_least_overlap_counts() -> None:
    still = (0.0, 0.0, 0.0, 4.0, 2.0)
    assert overlap(still, (np.nextafter(4.0, 0.0), 0.0, 0.0, 4.0, 2.0))
    assert overlap(still, (0.0, np.nextafter(2.0, 0.0), 0.0, 4.0, 2.0))
    assert overlap(still, (0.0, 0.0, 1.0, 0.1, 0.1))  # one inside the other
    assert overlap(still, still)


# overlapping_pairs


@pytest.mark.parametrize(("count", "spread"), [(1, 5.0), (2, 5.0), (60, 60.0), (150, 60.0), (250, 400.0)])
def test_pairs_agree_with_shapely(count: int, spread: float) -> None:
    rng = np.random.default_rng(count)
    found = 0
    for _ in range(6):
        boxes = random_boxes(rng, count, spread)
        pairs = overlapping_pairs(*boxes)
        shapes = polygons(boxes)
        i, j = np.triu_indices(count, 1)
        expected, sure = truth(shapes[i], shapes[j])
        assert sure.all()
        np.testing.assert_array_equal(pairs, np.column_stack([i[expected], j[expected]]))
        found += len(pairs)
    assert found > 0 or count < 60


def test_no_boxes_no_pairs() -> None:
    none = np.empty(0)
    assert overlapping_pairs(none, none, none, none, none).shape == (0, 2)
    far = overlapping_pairs(np.array([0.0, 50.0]), np.zeros(2), np.zeros(2), np.full(2, 4.0), np.full(2, 2.0))
    assert far.shape == (0, 2)


def test_a_long_vehicle_is_found_by_those_beyond_its_centre() -> None:
    x, y = np.array([0.0, 9.0, 12.0]), np.zeros(3)
    pairs = overlapping_pairs(x, y, y, np.array([20.0, 2.0, 2.0]), np.full(3, 2.0))
    assert pairs.tolist() == [[0, 1]]


# to_body


def test_to_body_says_ahead_and_left() -> None:
    ahead, left = to_body(np.array([0.0, 3.0, 0.0]), np.array([2.0, 0.0, -2.0]), np.pi / 2 * np.ones(3))
    np.testing.assert_allclose(ahead, [2.0, 0.0, -2.0], atol=1e-12)
    np.testing.assert_allclose(left, [0.0, -3.0, 0.0], atol=1e-12)
