"""The density of people's changes of speed: what it reads, and that it knows what people do."""

import numpy as np
import pytest
from safetensors.numpy import save_file

from litsim_policy.motion.speed_change import (
    FAR,
    FORMAT,
    Situation,
    features_of,
    load_speed_change,
    log_chance,
    packaged_speed_change,
)
from litsim_sim.core.errors import InputError

FOLLOWING = Situation(speed=10.0, gap=12.0, closing=0.0, leader_acceleration=0.0, usual_headway=1.4)


def chance(change: float, **situation: float) -> float:
    return float(np.exp(log_chance(change, FOLLOWING._replace(**situation), packaged_speed_change())))


def test_some_gain_is_certain_and_the_more_the_less_likely() -> None:
    chances = [chance(change) for change in (-5.0, -1.0, 0.0, 1.0, 3.0)]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] == pytest.approx(1.0, abs=0.01) and chances[-1] < 0.05


@pytest.mark.parametrize("worse", [{"gap": 3.0}, {"closing": 4.0}, {"leader_acceleration": -3.0}])
def test_people_keep_their_speed_less_often_behind_a_nearer_slower_or_braking_leader(worse: dict[str, float]) -> None:
    assert chance(0.0, **worse) < 0.7 * chance(0.0)


def test_who_usually_keeps_close_keeps_its_speed_there_more_often() -> None:
    assert chance(0.0, gap=7.0, usual_headway=0.6) > chance(0.0, gap=7.0, usual_headway=2.2)


def test_beyond_the_bounds_the_nearest_situation_counts() -> None:
    inside, outside = features_of(
        np.array([30.0, 90.0]),
        np.array([FAR, 500.0]),
        np.array([8.0, 60.0]),
        np.array([-4.0, -9.0]),
        np.array([3.0, 9.0]),
    )
    np.testing.assert_array_equal(inside, outside)


def test_other_networks_are_refused(tmp_path) -> None:
    path = tmp_path / "other.safetensors"
    save_file({"first.weight": np.zeros((2, 3, 4))}, path, {"format": FORMAT})
    with pytest.raises(InputError, match=r"other\.safetensors: tensors first have shapes"):
        load_speed_change(path)
