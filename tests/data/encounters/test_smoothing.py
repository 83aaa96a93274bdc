import numpy as np
import pytest

from litsim_data.encounters.smoothing import centred_place, centred_speed, drivable, trailing_fit

T = 0.1 * np.arange(100)
NOISE = np.random.default_rng(0).normal(scale=0.1, size=100)


def test_trailing_fit_follows_a_steady_change_without_lag() -> None:
    assert np.allclose(trailing_fit(3.0 + 2.0 * T), 3.0 + 2.0 * T)


def test_trailing_fit_never_looks_ahead() -> None:
    assert np.allclose(trailing_fit(NOISE)[:60], trailing_fit(NOISE[:60]))


def test_trailing_fit_is_the_end_of_the_weighted_line() -> None:
    time = T[:41] - T[40]
    line = np.polyfit(time, NOISE[:41], 1, w=np.exp(0.5 * time / 0.8))
    assert trailing_fit(NOISE[:41])[-1] == pytest.approx(line[1])


def test_centred_fits_keep_a_steady_acceleration() -> None:
    place = 5.0 * T + T**2
    assert np.allclose(centred_place(place), place)
    assert np.allclose(centred_speed(place), 5.0 + 2.0 * T)


def test_what_can_be_driven_is_consistent_and_near_the_record() -> None:
    place, speed = drivable(10.0 * T + NOISE, np.full(100, 10.0))
    assert np.allclose(np.diff(place), 0.05 * (speed[1:] + speed[:-1]))
    assert np.abs(place - 10.0 * T).max() < 0.15


def test_what_can_be_driven_never_looks_ahead_nor_reverses() -> None:
    record = 0.1 * T + NOISE
    place, speed = drivable(record, np.full(100, 0.1))
    assert np.array_equal(drivable(record[:60], np.full(60, 0.1))[0], place[:60])
    assert speed.min() == 0.0
