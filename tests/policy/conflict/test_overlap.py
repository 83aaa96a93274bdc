"""The probability of an overlap: against shapely where it is certain, against Monte Carlo where it is not."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.special import ndtri

from litsim_policy.conflict import overlap
from litsim_sim.core.geometry import box_corners
from strips import Strips

angles = st.floats(-np.pi, np.pi)
lengths, widths = st.floats(2.0, 15.0), st.floats(1.0, 3.0)
offsets = st.floats(-12.0, 12.0)
DRAWS = 40_000


def one(*values: float) -> list[np.ndarray]:
    return [np.array([value]) for value in values]


def strips_of(yaw_a: float, yaw_b: float, size_a: tuple[float, float], size_b: tuple[float, float]) -> Strips:
    return Strips.of(*one(yaw_a, yaw_b), tuple(one(*size_a)), tuple(one(*size_b)))


def polygon(x: float, y: float, yaw: float, size: tuple[float, float]) -> shapely.Polygon:
    return shapely.Polygon(box_corners(*one(x, y, yaw, *size))[0])


def spread(sigma_along: float, sigma_across: float, turn: float) -> np.ndarray:
    """(2, 2) covariance with principal axes turned by `turn`."""
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return axes @ np.diag([sigma_along**2, sigma_across**2]) @ axes.T


def flat(covariance: np.ndarray) -> tuple[float, float, float]:
    """Covariance (2, 2) as xx, yy, xy."""
    return covariance[0, 0], covariance[1, 1], covariance[0, 1]


def probability(boxes: tuple[float, ...], dx: float, dy: float, covariance: np.ndarray) -> float:
    """Of boxes (yaw_a, yaw_b, length_a, width_a, length_b, width_b)."""
    return overlap.probability(*overlap.strips(*boxes), dx, dy, *flat(covariance))


def drawn(strips: Strips, dx: float, dy: float, covariance: np.ndarray) -> float:
    """Monte Carlo estimate of the same."""
    x, y = np.random.default_rng(0).multivariate_normal([dx, dy], covariance, DRAWS).T
    return float(strips.contain(x, y).mean())


@given(offsets, offsets, angles, angles, st.tuples(lengths, widths), st.tuples(lengths, widths))
def test_the_strips_hold_the_distances_at_which_shapely_sees_an_overlap(dx, dy, yaw_a, yaw_b, size_a, size_b) -> None:
    a, b = polygon(0.0, 0.0, yaw_a, size_a), polygon(dx, dy, yaw_b, size_b)
    normal_x, normal_y, _, half = overlap.strips(yaw_a, yaw_b, *size_a, *size_b)
    contained = overlap.contain(normal_x, normal_y, half, dx, dy)
    assume(a.distance(b) > 1e-6 or a.intersection(b).area > 1e-6)  # touching is a matter of rounding
    assert contained == (a.intersection(b).area > 1e-6)


@given(angles, angles, st.tuples(lengths, widths), st.tuples(lengths, widths), angles)
def test_the_extent_is_that_of_the_minkowski_sum(yaw_a, yaw_b, size_a, size_b, direction) -> None:
    cos, sin = np.cos(direction), np.sin(direction)
    half = [
        0.5 * np.ptp(box_corners(*one(0.0, 0.0, y, *s))[0] @ [cos, sin]) for y, s in ((yaw_a, size_a), (yaw_b, size_b))
    ]
    found = strips_of(yaw_a, yaw_b, size_a, size_b).extent(*one(cos, sin))[0]
    assert found == pytest.approx(sum(half))


@settings(max_examples=150)
@example(
    (0.0, 1.5), (-2.5, -2.5, 0.75), (2.0, 1.0), (2.0, 1.5), (0.0625, 0.0547)
)  # an edge nearly across the minor axis
@given(
    st.tuples(offsets, offsets),
    st.tuples(angles, angles, angles),
    st.tuples(lengths, widths),
    st.tuples(lengths, widths),
    st.tuples(st.floats(0.05, 6.0), st.floats(0.05, 6.0)),
)
def test_the_probability_is_that_of_monte_carlo(delta, yaws, size_a, size_b, sigmas) -> None:
    covariance = spread(*sigmas, yaws[2])
    estimate = drawn(strips_of(*yaws[:2], size_a, size_b), *delta, covariance)
    noise = 5.0 * np.sqrt(max(estimate * (1.0 - estimate), 1.0 / DRAWS) / DRAWS)
    assert probability((*yaws[:2], *size_a, *size_b), *delta, covariance) == pytest.approx(estimate, abs=0.02 + noise)


@settings(max_examples=60)
@given(
    st.tuples(offsets, offsets),
    angles,
    st.tuples(lengths, widths),
    st.tuples(st.floats(0.02, 6.0), st.floats(0.02, 2.0)),
)
def test_in_a_lane_it_is_the_product_of_two_intervals(delta, yaw, size, sigmas) -> None:
    """Boxes and spread along one direction: along and across are independent, and each is an error function."""
    from scipy.stats import norm

    assume(abs(sigmas[0] - sigmas[1]) > 1e-3)  # a round spread has no direction, and is integrated along any
    cos, sin = np.cos(yaw), np.sin(yaw)
    along, left = delta[0] * cos + delta[1] * sin, delta[1] * cos - delta[0] * sin
    expected = 1.0
    for middle, reach, sigma in zip((along, left), size, sigmas, strict=True):
        expected *= norm.cdf((reach - middle) / sigma) - norm.cdf((-reach - middle) / sigma)
    found = probability((yaw, yaw, *size, *size), *delta, spread(*sigmas, yaw))
    assert found == pytest.approx(expected, abs=2e-3)


@given(
    st.tuples(offsets, offsets),
    st.tuples(angles, angles, angles),
    st.tuples(lengths, widths),
    st.tuples(st.floats(0.05, 6.0), st.floats(0.05, 6.0)),
    st.floats(0.02, 0.98),
)
def test_no_strip_rules_out_what_is_likely(delta, yaws, size, sigmas, least) -> None:
    boxes, covariance = (*yaws[:2], *size, *size), spread(*sigmas, yaws[2])
    normal_x, normal_y, _, half = overlap.strips(*boxes)
    if not overlap.can_reach(normal_x, normal_y, half, *delta, *flat(covariance), ndtri(least)):
        assert probability(boxes, *delta, covariance) < least + 0.02


def test_it_is_symmetric_and_between_zero_and_one() -> None:
    random = np.random.default_rng(3)
    covariance = np.array([[2.0, 0.8], [0.8, 1.0]])
    for _ in range(200):
        (yaw_a, yaw_b), (dx, dy) = random.uniform(-3, 3, 2), random.uniform(-8, 8, 2)
        a, b = zip(random.uniform(3, 10, 2), random.uniform(1, 3, 2), strict=True)
        one_way = probability((yaw_a, yaw_b, *a, *b), dx, dy, covariance)
        other = probability((yaw_b, yaw_a, *b, *a), -dx, -dy, covariance)
        assert one_way == pytest.approx(other, abs=1e-9) and 0.0 <= one_way <= 1.0 + 1e-9


# Against numpy


@settings(max_examples=300)
@given(
    st.tuples(offsets, offsets),
    st.tuples(angles, angles, angles),
    st.tuples(lengths, widths),
    st.tuples(lengths, widths),
    st.tuples(st.floats(0.0, 6.0), st.floats(0.0, 6.0)),
    st.floats(0.02, 0.98),
)
def test_strips_and_probabilities_are_those_of_numpy(delta, yaws, size_a, size_b, sigmas, least) -> None:
    expected, boxes = strips_of(*yaws[:2], size_a, size_b), (*yaws[:2], *size_a, *size_b)
    normal_x, normal_y, _, half = found = overlap.strips(*boxes)
    for values, name in zip(found, ("normal_x", "normal_y", "edge", "half"), strict=True):
        assert values == pytest.approx(getattr(expected, name)[:, 0].tolist(), abs=1e-12)
    xx, yy, xy = flat(spread(*sigmas, yaws[2]))
    covariance, distance = np.array([[xx], [yy], [xy]]), one(*delta)
    exact = float(expected.probability(*distance, covariance)[0])
    assert overlap.probability(*found, *delta, xx, yy, xy) == pytest.approx(exact, abs=1e-9)
    assert overlap.contain(normal_x, normal_y, half, *delta) == expected.contain(*distance)[0]
    reachable = overlap.can_reach(normal_x, normal_y, half, *delta, xx, yy, xy, ndtri(least))
    assert reachable == expected.can_reach(*distance, covariance, least)[0]
    likely = overlap.likely(*delta, *boxes, xx, yy, xy, least, ndtri(least))
    if xx + yy <= 0.0:
        assert likely == float(expected.contain(*distance)[0])
    elif abs(exact - least) > 1e-9:
        assert likely == pytest.approx(exact if reachable and exact >= least else 0.0, abs=1e-9)


@given(st.floats(-8.0, 8.0))
def test_the_share_below_is_that_of_scipy(value: float) -> None:
    from scipy.special import ndtr

    assert overlap.normal_below(value) == pytest.approx(ndtr(value), abs=1e-15)
