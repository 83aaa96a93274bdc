"""The overlap of agents that may do several things is the weighed mean of the overlaps of each."""

from __future__ import annotations

import numpy as np
import pytest
from litsim_policy.conflict.overlap_over_time import overlap_chances
from litsim_policy.conflict.weighed import weighed_chances
from scipy.special import ndtri

from litsim_policy.conflict.futures import OtherMotions, PredictedMotion

STEPS, COUNT = 12, 6
LENGTH, WIDTH = np.full(COUNT, 4.5), np.full(COUNT, 1.8)


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
        states += [(b.others.states[q], b.others.valid[q]) for q in np.flatnonzero(b.others.row == j)]
        for weight, (state, valid) in zip(weights.get(j, [1.0]), states, strict=True):
            alone = PredictedMotion(np.repeat(state[None], COUNT, axis=0), np.repeat(valid[None], COUNT, axis=0))
            parts = (a.states, a.valid, a.bounds, alone.states, alone.valid, alone.bounds, LENGTH, WIDTH)
            bound = (1e-3, float(ndtri(1e-3)), False)
            found[k] += weight * overlap_chances(np.array([[i, j]]), *parts, *bound)[0]
    return found


@pytest.fixture
def scene():
    """(pairs, a, b, weights): agents 1 and 4 of b may do two and one other thing."""
    rng = np.random.default_rng(5)
    row, weight = np.array([1, 1, 4]), np.array([0.3, 0.1, 0.45])
    others = OtherMotions(row, weight, *motion(rng, 3))
    a, b = PredictedMotion(*motion(rng)), PredictedMotion(*motion(rng), others)
    pairs = np.array([(i, j) for i in range(COUNT) for j in range(COUNT) if i != j])
    return pairs, a, b, {1: [0.6, 0.3, 0.1], 4: [0.55, 0.45]}


@pytest.mark.parametrize("least", [0.05, 0.2, 0.5])
def test_it_is_the_weighed_mean_where_that_reaches_the_bound(scene, least: float) -> None:
    pairs, a, b, weights = scene
    expected = by_hand(pairs, a, b, weights)
    found = weighed_chances(pairs, a, b, LENGTH, WIDTH, least)
    clear = np.abs(expected - least) > 2e-3
    assert ((expected >= least) & clear).sum() > 5 and ((expected < least) & (expected > 0.0)).sum() > 5
    np.testing.assert_array_equal((found >= least)[clear], (expected >= least)[clear])
    reached = found >= least
    np.testing.assert_allclose(found[reached], expected[reached], atol=2e-3)
    assert not found[~reached].any()


def test_what_only_another_manoeuvre_leads_to_is_seen_as_far_as_it_is_probable(scene) -> None:
    _, a, _, _ = scene
    states, valid = a.states[:1] + np.array([100.0, 0, 0, 0, 0, 0]), np.ones((1, STEPS), np.bool_)
    into = a.states[1:2].copy()
    into[:, :, 3:] = 0.0
    every = np.repeat(states, COUNT, axis=0), np.repeat(valid, COUNT, axis=0)
    b = PredictedMotion(*every, OtherMotions(np.array([0]), np.array([0.3]), into, valid))
    certain = PredictedMotion(np.concatenate([a.states[..., :3], np.zeros((COUNT, STEPS, 3))], axis=2), a.valid)
    (chance,) = weighed_chances(np.array([[1, 0]]), certain, b, LENGTH, WIDTH, 0.2)
    assert chance[a.valid[1]] == pytest.approx(0.3) and not chance[~a.valid[1]].any()
    assert not weighed_chances(np.array([[1, 0]]), certain, b, LENGTH, WIDTH, 0.35).any()
    assert not weighed_chances(np.array([[1, 0]]), certain, PredictedMotion(*every), LENGTH, WIDTH, 0.2).any()


def test_who_has_one_motion_is_as_before_and_first_stops_there(scene) -> None:
    pairs, a, b, _ = scene
    alone = PredictedMotion(b.states, b.valid)
    single = ~np.isin(pairs[:, 1], [1, 4])
    both, only = weighed_chances(pairs, a, b, LENGTH, WIDTH, 0.1), weighed_chances(pairs, a, alone, LENGTH, WIDTH, 0.1)
    np.testing.assert_array_equal(both[single], only[single])
    early = weighed_chances(pairs, a, b, LENGTH, WIDTH, 0.1, first=True)
    np.testing.assert_array_equal(early.any(axis=1), both.any(axis=1))
