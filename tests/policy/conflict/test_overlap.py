"""The probability of an overlap: against shapely where it is certain, against Monte Carlo where it is not."""

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.special import ndtri

from litsim_policy.conflict import overlap
from litsim_policy.conflict.broad_phase import may_overlap
from litsim_policy.conflict.futures import Boxes
from litsim_policy.conflict.overlap import mixture_overlap_probability
from litsim_policy.conflict.predicted_motion import XX, YAW, AlternativeMotions, PredictedMotion, X, Y
from litsim_sim.core import pair_geometry
from litsim_sim.core.geometry import box_corners, boxes_overlap

angles = st.floats(-np.pi, np.pi)
lengths, widths = st.floats(2.0, 15.0), st.floats(1.0, 3.0)
offsets = st.floats(-12.0, 12.0)
DRAWS = 40_000
seeds = st.integers(0, 2**32)


def one(*values: float) -> list[np.ndarray]:
    return [np.array([value]) for value in values]


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
    return overlap.probability_within(*overlap.strips(*boxes), dx, dy, flat(covariance))


def drawn(boxes: tuple[float, ...], dx: float, dy: float, covariance: np.ndarray) -> float:
    """Monte Carlo estimate of the same."""
    normal_x, normal_y, _, half = np.array(overlap.strips(*boxes))
    distances = np.random.default_rng(0).multivariate_normal([dx, dy], covariance, DRAWS)
    return float((np.abs(distances @ [normal_x, normal_y]) < half).all(axis=1).mean())


@given(offsets, offsets, angles, angles, st.tuples(lengths, widths), st.tuples(lengths, widths))
def test_the_strips_hold_the_distances_at_which_shapely_sees_an_overlap(dx, dy, yaw_a, yaw_b, size_a, size_b) -> None:
    a, b = polygon(0.0, 0.0, yaw_a, size_a), polygon(dx, dy, yaw_b, size_b)
    normal_x, normal_y, _, half = np.array(overlap.strips(yaw_a, yaw_b, *size_a, *size_b))
    contained = (np.abs(dx * normal_x + dy * normal_y) < half).all()
    assume(a.distance(b) > 1e-6 or a.intersection(b).area > 1e-6)  # touching is a matter of rounding
    assert contained == (a.intersection(b).area > 1e-6)


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
    covariance, boxes = spread(*sigmas, yaws[2]), (*yaws[:2], *size_a, *size_b)
    estimate = drawn(boxes, *delta, covariance)
    noise = 5.0 * np.sqrt(max(estimate * (1.0 - estimate), 1.0 / DRAWS) / DRAWS)
    assert probability(boxes, *delta, covariance) == pytest.approx(estimate, abs=0.02 + noise)


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


@given(st.floats(-8.0, 8.0))
def test_the_share_below_is_that_of_scipy(value: float) -> None:
    from scipy.special import ndtr

    assert overlap.normal_below(value) == pytest.approx(ndtr(value), abs=1e-15)


# Step by step of two motions


@given(seeds, st.floats(0.02, 0.9))
def test_probabilities_of_pairs_are_those_of_numpy_at_every_step(seed: int, least: float) -> None:
    random = np.random.default_rng(seed)
    length, width = random.uniform(3, 12, 6), random.uniform(1, 3, 6)

    def some(spread: float) -> PredictedMotion:
        sigma = spread * random.uniform(0.1, 2.0, (2, 6, 4))
        states = [*random.normal(0.0, 6.0, (2, 6, 4)), random.uniform(-3, 3, (6, 4)), *sigma**2, 0.5 * sigma.prod(0)]
        return PredictedMotion(np.stack(states, axis=-1), random.random((6, 4)) < 0.8)

    a, b = some(0.0), some(random.choice([0.0, 1.0]))
    which = random.integers(0, 6, (12, 2))
    which = which[np.argsort(which[:, 0], kind="stable")]
    found, until = (
        mixture_overlap_probability(which, a, b, (length, width), least, first=first) for first in (False, True)
    )

    i, j = which.T
    exact = np.zeros(found.shape)
    for k, t in np.ndindex(*found.shape):
        one, other = a.states[i[k], t], b.states[j[k], t]
        boxes = (one[YAW], other[YAW], length[i[k]], width[i[k]], length[j[k]], width[j[k]])
        delta, covariance = (other - one)[[X, Y]], one[XX:] + other[XX:]
        if covariance[0] + covariance[1] > 0.0:
            exact[k, t] = overlap.probability_within(*overlap.strips(*boxes), *delta, tuple(covariance))
        else:
            exact[k, t] = pair_geometry.overlap(*delta, *boxes)
    both = a.valid[i] & b.valid[j]
    expected = np.where(both & (exact >= least), exact, 0.0)
    sure = np.abs(exact - least) > 0.02  # the strips bound the probability, which the quadrature gives to 0.02
    assert found[sure] == pytest.approx(expected[sure], abs=1e-9)
    some = (found > 0.0).any(axis=1)
    first = np.where(some, (found > 0.0).argmax(axis=1), 3)
    enough = np.array([some[:k][which[:k, 0] == agent].any() for k, agent in enumerate(which[:, 0])])
    assert (until == np.where(~enough[:, None] & (np.arange(4) <= first[:, None]), found, 0.0)).all()


@given(seeds, st.floats(0.02, 0.9))
def test_who_may_not_overlap_does_not_in_any_way(seed: int, least: float) -> None:
    random, time = np.random.default_rng(seed), 0.1 * np.arange(1, 6)

    def some(count: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
        place = random.normal(0.0, 12.0, (count, 1, 2)) + random.normal(0.0, 8.0, (count, 1, 2)) * time[:, None]
        variance = np.broadcast_to((spread * time[:, None]) ** 2 * [1.0, 1.0, 0.0], (count, 5, 3))
        yaw = np.broadcast_to(random.uniform(-3, 3, (count, 1, 1)), (count, 5, 1))
        return np.concatenate([place, yaw, variance], axis=-1), random.random((count, 5)) < 0.8

    length, width = random.uniform(3, 6, 6), random.uniform(1, 3, 6)
    row = np.sort(random.integers(0, 6, 3))
    a = PredictedMotion(*some(6, 0.0))
    b = PredictedMotion(*some(6, 1.0), AlternativeMotions(row, np.full(3, 0.3), *some(3, 1.0)))
    x, y, yaw = random.normal(0.0, 8.0, (3, 6))
    speed, acceleration = random.uniform(0.0, 20.0, 6), random.normal(0.0, 3.0, 6)
    which = np.argwhere(~np.eye(6, dtype=np.bool_)).copy()
    goes_on = 0.1 * random.integers(0, 6, 6)
    boxes = Boxes(x, y, yaw, speed, acceleration, length, width, goes_on)
    may = may_overlap(which, a, b, boxes, max(0.0, -ndtri(least)))
    probability = mixture_overlap_probability(which, a, b, (length, width), least)
    closing = overlap.closing_overlaps(which, (a.states, a.valid), boxes, False)  # noqa: FBT003 - a kernel's
    assert not probability[~may].any() and not closing[~may].any()
    for (i, j), found in zip(which.tolist(), closing, strict=True):
        for k in range(5):
            until = time[k] if acceleration[j] >= 0.0 else min(time[k], -speed[j] / acceleration[j])
            gone = speed[j] * until + 0.5 * acceleration[j] * until**2
            away = x[j] + gone * np.cos(yaw[j]) - a.x[i, k], y[j] + gone * np.sin(yaw[j]) - a.y[i, k]
            sizes = (length[i], width[i]), (length[j], width[j])
            looked = time[k] < goes_on[j] + 0.05 and a.valid[i, k]
            assert found[k] == (looked and bool(boxes_overlap(*away, a.yaw[i, k], yaw[j], *sizes)))


def test_of_pairs_side_by_side_in_lanes_few_are_left() -> None:
    """Standing columns of three lanes, 3.6 m apart: with a margin of 25 m, only pairs of one lane may overlap."""
    x, y = (grid.ravel() for grid in np.meshgrid(10.0 * np.arange(8), 3.6 * np.arange(3), indexing="ij"))
    turn, still = 0.7, np.zeros(24)
    along, across = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    states = np.stack([along, across, still + turn, still, still, still], axis=-1)[:, None].repeat(30, axis=1)
    standing = PredictedMotion(states, np.ones((24, 30), np.bool_))
    boxes = Boxes(along, across, still + turn, still, still, still + 29.5, still + 1.8, still + 1.0)
    which = np.argwhere(~np.eye(24, dtype=np.bool_)).copy()
    may = may_overlap(which, standing, standing, boxes, 0.8)
    i, j = which.T
    np.testing.assert_array_equal(may, (np.abs(x[i] - x[j]) < 29.0) & (y[i] == y[j]))


PAIR = np.array([[0, 1]])


def standing(x: float, y: float, yaw: float, sigma: float, valid: tuple[bool, ...] = (True,) * 3) -> PredictedMotion:
    """Both rows alike, over three steps."""
    state = [x, y, yaw, sigma**2, sigma**2, 0.0]
    return PredictedMotion(np.tile(state, (2, len(valid), 1)), np.tile(valid, (2, 1)))


def of_pair(a: PredictedMotion, b: PredictedMotion, least: float) -> np.ndarray:
    """(3,) probabilities that the boxes of a and b overlap."""
    return mixture_overlap_probability(PAIR, a, b, (np.full(2, 4.5), np.full(2, 2.0)), least)[0]


@given(
    st.tuples(st.floats(-14.0, 14.0), st.floats(-10.0, 10.0)),
    st.tuples(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1)),
    st.tuples(st.floats(0.0, 3.0), st.floats(0.05, 4.0)),
    st.floats(0.02, 0.7),
)
@example((6.0, 0.0), (0.0, 0.0), (0.0, 1.0), 0.05)  # beyond the circles around both boxes, within the spread
@example((-6.0, 0.0), (0.0, 0.0), (1.0, 0.05), 0.05)
@example((0.0, 3.0), (0.0, 0.0), (0.0, 1.0), 0.05)
@example((0.0, -3.0), (0.0, 0.0), (0.0, 1.0), 0.05)
@example((4.0, 0.0), (0.0, 0.0), (0.0, 0.1), 0.5)  # their centres are at different places, and they never move
@example((-4.0, 0.0), (0.0, 0.0), (0.0, 0.1), 0.5)
def test_nothing_likely_is_ruled_out(delta, yaws, sigmas, least: float) -> None:
    a, b = standing(0.0, 0.0, yaws[0], sigmas[0]), standing(*delta, yaws[1], sigmas[1])
    exact = probability((*yaws, 4.5, 2.0, 4.5, 2.0), *delta, np.eye(2) * (sigmas[0] ** 2 + sigmas[1] ** 2))
    expected = exact if exact >= least else 0.0
    assert of_pair(a, b, least) == pytest.approx(np.full(3, expected), abs=1e-9)


@pytest.mark.parametrize(
    ("valid_a", "valid_b"), [((True, False, True), (True, True, True)), ((True, True, True), (True, False, True))]
)
def test_whoever_is_not_there_overlaps_nobody(valid_a, valid_b) -> None:
    a, b = standing(0.0, 0.0, 0.0, 0.0, valid_a), standing(1.0, 0.0, 0.0, 0.0, valid_b)
    assert of_pair(a, b, 0.5).tolist() == [1.0, 0.0, 1.0]


# Mixtures of several motions

STEPS, COUNT = 12, 6
SIZES = np.full(COUNT, 4.5), np.full(COUNT, 1.8)


def motion(rng: np.random.Generator, count: int = COUNT) -> tuple[np.ndarray, np.ndarray]:
    """States of agents that start within a few metres of each other, and when they are valid."""
    begin = rng.uniform(-6.0, 6.0, (count, 1, 2))
    velocity = rng.uniform(-4.0, 4.0, (count, 1, 2))
    time = 0.1 * np.arange(1, STEPS + 1)[None, :, None]
    spread = rng.uniform(0.2, 1.0, (count, 1, 1)) * time
    yaw = np.repeat(rng.uniform(-np.pi, np.pi, (count, 1, 1)), STEPS, axis=1)
    states = np.concatenate([begin + velocity * time, yaw, spread**2, spread**2, np.zeros_like(spread)], axis=2)
    return states, rng.random((count, STEPS)) < 0.9


def by_hand(pairs: np.ndarray, a: PredictedMotion, b: PredictedMotion, weights: dict[int, list[float]]) -> np.ndarray:
    """Every motion of b alone, weighed; `weights` has those of each agent, its first motion first."""
    found = np.zeros((len(pairs), STEPS))
    for k, (i, j) in enumerate(pairs.tolist()):
        states = [(b.states[j], b.valid[j])]
        states += [(b.alternatives.states[q], b.alternatives.valid[q]) for q in np.flatnonzero(b.alternatives.row == j)]
        for weight, (state, valid) in zip(weights.get(j, [1.0]), states, strict=True):
            alone = PredictedMotion(np.repeat(state[None], COUNT, axis=0), np.repeat(valid[None], COUNT, axis=0))
            found[k] += weight * mixture_overlap_probability(np.array([[i, j]]), a, alone, SIZES, 1e-3)[0]
    return found


@pytest.fixture
def mixture():
    """(pairs, a, b, weights): agents 1 and 4 of b may do two and one other thing."""
    rng = np.random.default_rng(5)
    row, weight = np.array([1, 1, 4]), np.array([0.3, 0.1, 0.45])
    others = AlternativeMotions(row, weight, *motion(rng, 3))
    a, b = PredictedMotion(*motion(rng)), PredictedMotion(*motion(rng), others)
    pairs = np.array([(i, j) for i in range(COUNT) for j in range(COUNT) if i != j])
    return pairs, a, b, {1: [0.6, 0.3, 0.1], 4: [0.55, 0.45]}


@pytest.mark.parametrize("least", [0.05, 0.2, 0.5])
def test_it_is_the_weighed_mean_where_that_reaches_the_bound(mixture, least: float) -> None:
    pairs, a, b, weights = mixture
    expected = by_hand(pairs, a, b, weights)
    found = mixture_overlap_probability(pairs, a, b, SIZES, least)
    clear = np.abs(expected - least) > 2e-3
    assert ((expected >= least) & clear).sum() > 5 and ((expected < least) & (expected > 0.0)).sum() > 5
    np.testing.assert_array_equal((found >= least)[clear], (expected >= least)[clear])
    reached = found >= least
    np.testing.assert_allclose(found[reached], expected[reached], atol=2e-3)
    assert not found[~reached].any()


def test_what_only_another_manoeuvre_leads_to_is_seen_as_far_as_it_is_probable(mixture) -> None:
    _, a, _, _ = mixture
    states, valid = a.states[:1] + np.array([100.0, 0, 0, 0, 0, 0]), np.ones((1, STEPS), np.bool_)
    into = a.states[1:2].copy()
    into[:, :, 3:] = 0.0
    every = np.repeat(states, COUNT, axis=0), np.repeat(valid, COUNT, axis=0)
    b = PredictedMotion(*every, AlternativeMotions(np.array([0]), np.array([0.3]), into, valid))
    certain = PredictedMotion(np.concatenate([a.states[..., :3], np.zeros((COUNT, STEPS, 3))], axis=2), a.valid)
    (probability,) = mixture_overlap_probability(np.array([[1, 0]]), certain, b, SIZES, 0.2)
    assert probability[a.valid[1]] == pytest.approx(0.3) and not probability[~a.valid[1]].any()
    assert not mixture_overlap_probability(np.array([[1, 0]]), certain, b, SIZES, 0.35).any()
    assert not mixture_overlap_probability(np.array([[1, 0]]), certain, PredictedMotion(*every), SIZES, 0.2).any()


def test_who_has_one_motion_is_as_before_and_first_stops_there(mixture) -> None:
    pairs, a, b, _ = mixture
    alone = PredictedMotion(b.states, b.valid)
    single = ~np.isin(pairs[:, 1], [1, 4])
    both, only = (
        mixture_overlap_probability(pairs, a, b, SIZES, 0.1),
        mixture_overlap_probability(pairs, a, alone, SIZES, 0.1),
    )
    np.testing.assert_array_equal(both[single], only[single])
    early = mixture_overlap_probability(pairs, a, b, SIZES, 0.1, first=True)
    agents = pairs[both.any(axis=1), 0]
    np.testing.assert_array_equal(pairs[early.any(axis=1), 0], np.unique(agents))
    assert len(np.unique(agents)) < len(agents), "one pair of each agent is enough"
