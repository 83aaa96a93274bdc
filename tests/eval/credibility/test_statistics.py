"""Statistics of encounters, beside numpy's and scipy's on the same draws."""

import numpy as np
import pytest
from scipy.stats import ks_2samp

from litsim_eval.campaign.bootstrap import drawn_units, times_drawn
from litsim_eval.credibility.statistics import (
    areas_under_curve,
    covered,
    crps,
    kappas,
    ks_distances,
    means,
    medians,
    once,
)

COUNT = 40
DRAWS = drawn_units(COUNT)[:5]
TIMES = times_drawn(COUNT)[:5]
RNG = np.random.default_rng(1)
VALUES, OTHERS = RNG.normal(size=(2, COUNT)).round(1)


def test_means_and_medians_are_those_of_the_drawn_values() -> None:
    assert means(VALUES, TIMES) == pytest.approx(VALUES[DRAWS].mean(axis=1))
    assert medians(VALUES, TIMES) == pytest.approx(np.median(VALUES[DRAWS], axis=1))


def test_absent_values_are_left_out() -> None:
    some = np.where(VALUES > 0, VALUES, np.nan)
    assert means(some, TIMES) == pytest.approx(np.nanmean(some[DRAWS], axis=1))
    assert medians(some, TIMES) == pytest.approx(np.nanmedian(some[DRAWS], axis=1))
    assert np.isnan(medians(np.full(3, np.nan), once(3))).all()


def test_several_runs_of_an_encounter_count_together() -> None:
    runs = RNG.normal(size=(COUNT, 3))
    assert medians(runs, TIMES) == pytest.approx([np.median(runs[draw]) for draw in DRAWS])


def test_distance_of_distributions_is_that_of_scipy() -> None:
    expected = [ks_2samp(VALUES[draw], OTHERS[draw]).statistic for draw in DRAWS]
    assert ks_distances(VALUES, OTHERS, TIMES) == pytest.approx(expected)


def test_those_who_never_react_count_in_the_distance() -> None:
    never, always = np.array([1.0, 2.0, np.nan, np.nan]), np.array([1.0, 2.0, 1.0, 2.0])
    assert ks_distances(never, always, once(4)) == pytest.approx(0.5)
    assert ks_distances(never, never, once(4)) == pytest.approx(0.0)


def test_area_under_the_curve_counts_pairs_in_the_right_order() -> None:
    scores, positive = np.array([3.0, 1.0, 2.0, 1.0]), np.array([True, True, False, False])
    assert areas_under_curve(scores, positive, once(4)) == pytest.approx((1 + 1 + 0 + 0.5) / 4)
    assert np.isnan(areas_under_curve(scores, np.zeros(4, bool), once(4))).all()


def test_kappa_is_agreement_beyond_chance() -> None:
    people = np.array([True, True, False, False])
    never = np.zeros(4, bool)
    assert kappas(people, people, once(4)) == pytest.approx(1.0)
    assert kappas(never, people, once(4)) == pytest.approx(0.0)
    assert kappas(~people, people, once(4)) == pytest.approx(-1.0)


def test_score_of_equal_draws_is_the_error_and_a_spread_around_the_truth_is_better() -> None:
    truth = np.zeros(2)
    assert crps(np.array([[2.0, 2.0], [-1.0, 3.0]]), truth) == pytest.approx([2.0, 0.0])


@pytest.mark.parametrize("level", [0.5, 0.9])
def test_coverage_of_draws_from_the_same_distribution_is_the_level(level: float) -> None:
    drawn, truth = RNG.normal(size=(20_000, 19)), RNG.normal(size=20_000)
    assert covered(drawn, truth, level).mean() == pytest.approx(level, abs=0.01)
    assert covered(drawn, truth + 9.0, level).mean() < 0.01
