"""Pairs of agents by compiled loops, against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from litsim_policy.conflict.pairs import FOLLOWED
from litsim_policy.conflict.weighed import weighed_chances
from scipy.special import ndtri

from litsim_policy.conflict import overlap_over_time, pairs
from litsim_policy.conflict.futures import OtherMotions, PredictedMotion, X, Y, widest
from litsim_sim.core.geometry import boxes_overlap, to_body
from strips import Strips

seeds, radii = st.integers(0, 2**32), st.floats(0.0, 60.0)


@given(seeds, radii, st.floats(0.0, 5.0), st.integers(0, 15))
def test_who_is_near_whom(seed: int, radius: float, time: float, agents: int) -> None:
    random = np.random.default_rng(seed)
    x, y = random.normal(0.0, 30.0, (2, agents))
    yaw, speed = random.uniform(-4.0, 4.0, agents), random.uniform(0.0, 15.0, agents)
    of, others = random.random((2, agents)) < 0.5
    scene = np.sort(random.integers(0, 3, agents))
    now, soon = np.array([x, y]), np.array([x, y]) + 1e-4 * speed * np.array([np.cos(yaw), np.sin(yaw)])
    apart, then = (np.hypot(*(p[:, :, None] - p[:, None])) for p in (now, soon))
    within = (apart <= radius) | (apart - time * np.maximum((apart - then) / 1e-4, 0.0) <= radius + 1e-3)
    sure = (apart <= radius) | (np.abs(apart - time * (apart - then) / 1e-4 - radius) > 0.1)  # not a matter of rounding
    mine = within & (scene[:, None] == scene)
    np.fill_diagonal(mine, val=False)
    asked = sure & of[:, None] & others
    found = np.zeros_like(mine)
    found[tuple(pairs.near(scene, x, y, yaw, speed, of, others, radius, time).T)] = True
    assert (found == mine)[asked].all() and not found[~(of[:, None] & others)].any()
    any_of = pairs.near_any(scene, x, y, yaw, speed, of, radius, time)
    everybody = np.ones(agents, np.bool_)
    reached = pairs.near(scene, x, y, yaw, speed, everybody, of, radius, time)[:, 0]
    assert any_of.nonzero()[0].tolist() == sorted({*of.nonzero()[0].tolist(), *reached.tolist()})


@given(seeds)
def test_a_follower_has_the_other_ahead_in_its_strip_and_heads_the_same_way(seed: int) -> None:
    random = np.random.default_rng(seed)
    x, y = random.normal(0.0, [[12.0], [2.0]], (2, 8))
    yaw, length, width = (
        random.normal(0.0, random.choice([0.5, 3.0]), 8),
        random.uniform(3, 12, 8),
        random.uniform(1, 3, 8),
    )
    leader, follower = both = random.integers(0, 8, (2, 40))
    ahead, left = to_body(x[leader] - x[follower], y[leader] - y[follower], yaw[follower])
    expected = ahead > FOLLOWED * 0.5 * (length[leader] + length[follower])
    expected &= np.abs(left) < 0.5 * (width[leader] + width[follower])
    expected &= np.cos(yaw[leader] - yaw[follower]) > 0.0
    assert pairs.followed(both.T.copy(), x, y, yaw, length, width).tolist() == expected.tolist()


@given(seeds, st.floats(0.02, 0.9))
def test_chances_of_pairs_are_those_of_numpy_at_every_step(seed: int, least: float) -> None:
    random = np.random.default_rng(seed)
    length, width = random.uniform(3, 12, 6), random.uniform(1, 3, 6)

    def some(spread: float) -> PredictedMotion:
        sigma = spread * random.uniform(0.1, 2.0, (2, 6, 4))
        states = [*random.normal(0.0, 6.0, (2, 6, 4)), random.uniform(-3, 3, (6, 4)), *sigma**2, 0.5 * sigma.prod(0)]
        return PredictedMotion(np.stack(states, axis=-1), random.random((6, 4)) < 0.8)

    a, b = some(0.0), some(random.choice([0.0, 1.0]))
    which = random.integers(0, 6, (12, 2))
    arrays = (which, a.states, a.valid, a.bounds, b.states, b.valid, b.bounds, length, width, least, ndtri(least))
    found, until = overlap_over_time.overlap_chances(*arrays, False), overlap_over_time.overlap_chances(*arrays, True)  # noqa: FBT003

    i, j = which.T
    distance = (b.states[j] - a.states[i])[..., [X, Y]].reshape(-1, 2).T
    sizes = [tuple(np.repeat(values[k], 4) for values in (length, width)) for k in (i, j)]
    strips = Strips.of(a.yaw[i].ravel(), b.yaw[j].ravel(), *sizes)
    covariance = (a.covariance[i] + b.covariance[j]).reshape(-1, 3).T
    exact = np.where(
        covariance[0] + covariance[1] > 0.0,
        strips.probability(*distance, covariance),
        strips.contain(*distance).astype(np.float64),
    ).reshape(found.shape)
    both = a.valid[i] & b.valid[j]
    expected = np.where(both & (exact >= least), exact, 0.0)
    sure = np.abs(exact - least) > 0.02  # the strips bound the probability, which the quadrature gives to 0.02
    assert found[sure] == pytest.approx(expected[sure], abs=1e-9)
    first = np.where((found > 0.0).any(axis=1), (found > 0.0).argmax(axis=1), 3)
    assert (until == np.where(np.arange(4) <= first[:, None], found, 0.0)).all()


@given(seeds, st.floats(0.02, 0.9))
def test_who_is_out_of_reach_by_the_bounds_overlaps_nobody_in_any_way(seed: int, least: float) -> None:
    random, time = np.random.default_rng(seed), 0.1 * np.arange(1, 6)

    def some(count: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
        place = random.normal(0.0, 12.0, (count, 1, 2)) + random.normal(0.0, 8.0, (count, 1, 2)) * time[:, None]
        variance = np.broadcast_to((spread * time[:, None]) ** 2 * [1.0, 1.0, 0.0], (count, 5, 3))
        yaw = np.broadcast_to(random.uniform(-3, 3, (count, 1, 1)), (count, 5, 1))
        return np.concatenate([place, yaw, variance], axis=-1), random.random((count, 5)) < 0.8

    length, width = random.uniform(3, 6, 6), random.uniform(1, 3, 6)
    row = np.sort(random.integers(0, 6, 3))
    a = PredictedMotion(*some(6, 0.0))
    b = PredictedMotion(*some(6, 1.0), OtherMotions(row, np.full(3, 0.3), *some(3, 1.0)))
    x, y, yaw = random.normal(0.0, 8.0, (3, 6))
    speed, acceleration = random.uniform(0.0, 20.0, 6), random.normal(0.0, 3.0, 6)
    which = np.argwhere(~np.eye(6, dtype=np.bool_)).copy()
    goes_on = 0.1 * random.integers(0, 6, 6)
    anywhere = widest(b.bounds, row, b.others.bounds, x, y, speed, acceleration, goes_on)
    reached = overlap_over_time.within_bounds(which, a.bounds, anywhere, length, width, max(0.0, -ndtri(least)))
    chance = weighed_chances(which, a, b, length, width, least)
    closing = overlap_over_time.closing_chances(
        which, a.states, a.valid, x, y, yaw, speed, acceleration, length, width, goes_on
    )
    assert not chance[~reached].any() and not closing[~reached].any()
    for (i, j), found in zip(which.tolist(), closing, strict=True):
        for k in range(5):
            now = time[k] if acceleration[j] >= 0.0 else min(time[k], -speed[j] / acceleration[j])
            gone = speed[j] * now + 0.5 * acceleration[j] * now**2
            away = x[j] + gone * np.cos(yaw[j]) - a.x[i, k], y[j] + gone * np.sin(yaw[j]) - a.y[i, k]
            sizes = (length[i], width[i]), (length[j], width[j])
            looked = time[k] < goes_on[j] + 0.05 and a.valid[i, k]
            assert found[k] == (looked and bool(boxes_overlap(*away, a.yaw[i, k], yaw[j], *sizes)))
