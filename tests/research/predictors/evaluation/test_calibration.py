"""What detection says of an ego that leaves its log, beside what comes of it; counted by hand."""

import numpy as np
import pytest

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.detector import ConflictDetector
from litsim_research.predictors.evaluation.calibration import SECONDS, PairScores, score_drives
from litsim_sim.scenario.scenario import Scenario

AT = SECONDS.index(3)


def scores(scenario: Scenario) -> PairScores:
    detector = ConflictDetector(scenario.log, scenario.roi_m, ConflictConfig(sigma_scale=0.0))
    return score_drives(scenario, 1, detector, "kinematic", 0)


@pytest.fixture
def slower_leader(make_scenario, track) -> PairScores:
    """The log of ego 1 brakes softly behind agent 2, which is slower; an ego that keeps its speed runs into it."""
    ego = track(1, x=100.0, speed=12.0, acceleration=-1.0, last=120)
    return scores(make_scenario(ego, track(2, x=122.0, speed=7.0, last=120), history_steps=20))


def test_what_is_said_and_what_comes_of_it_are_set_side_by_side(slower_leader) -> None:
    known = slower_leader.known[:, AT]
    real, said = slower_leader.real[known, AT], slower_leader.probability[known, AT] >= 0.5
    assert real.any() and not real.all()
    assert (said & real).sum() > 0.8 * real.sum(), "of constant speed, constant velocity is a good forecast"
    nearer, farther = slower_leader.real[:, 0], slower_leader.real[:, AT]
    assert not (nearer & ~farther).any(), "who meets within 1 s meets within 3 s"
    assert (slower_leader.probability[:, 0] <= slower_leader.probability[:, AT]).all()


def test_nobody_near_is_no_pair(make_scenario, track) -> None:
    far = scores(make_scenario(track(1, x=100.0, last=120), track(2, x=400.0, last=120), history_steps=20))
    assert far.probability.shape == far.real.shape == far.known.shape == (0, len(SECONDS))


def test_a_pair_counts_until_it_first_meets(make_scenario, track) -> None:
    touching = scores(make_scenario(track(1, x=100.0, last=120), track(2, x=102.0, last=120), history_steps=20))
    assert not len(touching.probability)


def test_the_curve_is_counted_by_threshold() -> None:
    chance, real = np.array([0.9, 0.6, 0.6, 0.2, 0.0]), np.array([True, False, True, True, False])
    known = np.array([True, True, True, True, True])
    wide = [np.repeat(values[:, None], len(SECONDS), axis=1) for values in (chance, real, known)]
    precision, recall = PairScores(*wide).curve(3, np.array([0.1, 0.5, 0.8, 0.95]))
    np.testing.assert_allclose(precision, [3 / 4, 2 / 3, 1.0, np.nan])
    np.testing.assert_allclose(recall, [1.0, 2 / 3, 1 / 3, 0.0])
    wide[2][0] = False
    _, recall = PairScores(*wide).curve(3, np.array([0.5]))
    assert recall == pytest.approx([0.5]), "a drive that ends before says nothing"
