"""Likelihood of the log under the run, against values worked out by hand."""

import numpy as np
import pytest

from litsim_eval.analysis.measures.motion_features import FEATURES, SIM_AGENTS, Sampled
from litsim_eval.analysis.measures.sim_agents import GROUPS, Acts, log_likelihood

NOTHING = Acts(collided=(), ran_red=None)


def sampled(bin_of_speed: list[int], agent: int = 1, off_road: int = 0) -> Sampled:
    """An agent with these bins of speed, and the same bin of all other features at each step."""
    ids = np.full(len(bin_of_speed), agent)
    bins = {name: np.zeros(len(ids), np.uint8) for name in SIM_AGENTS}
    bins |= {"linear_speed": np.array(bin_of_speed, np.uint8), "off_road": np.full(len(ids), off_road, np.uint8)}
    return Sampled(ids, dict.fromkeys(FEATURES, np.empty(0, np.uint8)), bins)


def test_the_weights_are_those_of_the_challenge_and_sum_to_one() -> None:
    assert sum(feature.weight for feature in SIM_AGENTS.values()) == pytest.approx(1.0)
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(SIM_AGENTS)


def test_a_logged_step_is_as_likely_as_its_bin_in_the_run() -> None:
    """Ten bins with 0.1 more each: of the run's four steps, one is in the bin of the log."""
    found = log_likelihood((sampled([3, 3, 3, 5]), NOTHING), (sampled([5, 5]), NOTHING), {1})
    assert found is not None
    assert found["features"]["linear_speed"] == pytest.approx(1.1 / 5.0)
    assert found["features"]["linear_acceleration"] == pytest.approx(4.1 / (4.0 + 11 * 0.1))
    assert found["features"]["traffic_light_violation"] is None, "there are no signals"
    assert found["agents"] == 1


def test_agents_are_judged_each_under_their_own_histogram() -> None:
    run, log = (
        Sampled(*(_joined(field, *both) for field in ("ids", "realism", "sim_agents")))
        for both in ((sampled([1] * 9), sampled([2] * 9, agent=2)), (sampled([2] * 9), sampled([1] * 9, agent=2)))
    )
    swapped = log_likelihood((run, NOTHING), (log, NOTHING), {1, 2})
    alone = log_likelihood((sampled([1] * 9), NOTHING), (sampled([1] * 9), NOTHING), {1})
    assert swapped is not None and alone is not None
    assert swapped["features"]["linear_speed"] == pytest.approx(0.1 / 10.0)
    assert alone["features"]["linear_speed"] == pytest.approx(9.1 / 10.0)


def _joined(field: str, first: Sampled, second: Sampled) -> object:
    one, other = getattr(first, field), getattr(second, field)
    return np.append(one, other) if field == "ids" else {name: np.append(one[name], other[name]) for name in one}


@pytest.mark.parametrize(
    ("act", "run"), [("collision", Acts({1}, set())), ("traffic_light_violation", Acts(set(), {1}))]
)
def test_what_agents_never_did_in_the_log_is_unlikely_once_they_do(act: str, run: Acts) -> None:
    log = sampled([1] * 9), Acts(set(), set())
    does, does_not = (log_likelihood((sampled([1] * 9), acts), log, {1}) for acts in (run, log[1]))
    assert does is not None and does_not is not None
    assert does["features"][act] == pytest.approx(0.001 / 1.002)
    assert does_not["features"][act] == pytest.approx(1.001 / 1.002)


def test_who_leaves_the_road_once_has_left_it() -> None:
    left = log_likelihood((sampled([1], off_road=1), NOTHING), (sampled([1]), NOTHING), {1})
    assert left is not None
    assert left["features"]["off_road"] == pytest.approx(0.001 / 1.002)
    assert left["map"] == pytest.approx((0.05 * 1.1 / 2.0 + 0.25 * 0.001 / 1.002) / 0.3)


def test_nobody_in_the_log_is_nothing_to_judge() -> None:
    assert log_likelihood((sampled([1]), NOTHING), (sampled([1]), NOTHING), {7}) is None
