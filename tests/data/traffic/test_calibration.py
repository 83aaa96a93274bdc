"""Car-following models and their fit: equations by hand, recovery of known drivers, what is shipped."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from litsim_data.traffic import calibration_run
from litsim_data.traffic.calibration import (
    IDM,
    KRAUSS,
    Model,
    Pairs,
    fit_common,
    fit_each,
    gap_rmse,
    idm_step,
    krauss_step,
    simulate,
)
from litsim_data.traffic.calibration_data import I80_PAIRS, STEPS_MAX, STEPS_MIN, car_following, count_lane_changes
from litsim_data.traffic.drivers import PARAMETERS, calibrated
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S

DRIVERS = np.array([[22.0, 1.2, 2.5, 1.4, 1.8], [28.0, 0.8, 3.5, 1.0, 1.2]])


def pairs_of(model: Model, drivers: np.ndarray, steps: int = 500) -> Pairs:
    """Pairs whose followers drive as `model` says behind leaders that slow down and speed up."""
    time = np.arange(steps) * STEP_S
    leader_speed = 11.0 + 5.0 * np.sin(2 * np.pi * time / 23.0) + 3.0 * np.sin(2 * np.pi * time / 11.0)
    leader_speed = np.broadcast_to(leader_speed, (len(drivers), steps))
    leader = 30.0 + np.cumsum(leader_speed, axis=1) * STEP_S
    still = Pairs(
        name=np.array(["made"] * len(drivers)),
        follower=np.arange(len(drivers)),
        valid=np.ones(leader.shape, np.bool_),
        gap=leader,  # with the follower at 0
        position=np.zeros(leader.shape),
        speed=np.full(leader.shape, 11.0),
        leader_speed=leader_speed,
    )
    gap = simulate(model, drivers, still)
    return replace(still, gap=gap, position=leader - gap, speed=np.gradient(leader - gap, STEP_S, axis=1))


def test_idm_by_hand() -> None:
    p = np.array([20.0, 1.5, 2.0, 1.0, 2.25])
    # Free road at the desired speed: nothing changes; far behind: a_max at standstill.
    assert idm_step(p, np.array(1e9), np.array(20.0), np.array(20.0)) == pytest.approx(20.0)
    assert idm_step(p, np.array(1e9), np.array(0.0), np.array(0.0)) == pytest.approx(0.1)
    # v 10, leader 8, gap 20: s* = 2 + 15 + 10 * 2 / (2 * 1.5) = 23.667; a = 1 - 1/16 - 1.40028
    after = idm_step(p, np.array(20.0), np.array(10.0), np.array(8.0))
    assert after == pytest.approx(10.0 + 0.1 * (1 - 1 / 16 - (23.6666667 / 20) ** 2), abs=1e-6)


def test_krauss_by_hand() -> None:
    p = np.array([20.0, 1.0, 2.0, 2.0, 4.0])
    # Safe speed behind a standing leader at 12 m: -4 + sqrt(16 + 2 * 4 * 10) = 5.798
    assert krauss_step(p, np.array(12.0), np.array(6.0), np.array(0.0)) == pytest.approx(-4 + np.sqrt(96), abs=1e-9)
    assert krauss_step(p, np.array(500.0), np.array(10.0), np.array(10.0)) == pytest.approx(10.2)
    assert krauss_step(p, np.array(0.5), np.array(6.0), np.array(0.0)) == pytest.approx(5.2)  # brakes at most with 8


@pytest.mark.parametrize("model", [IDM, KRAUSS], ids=lambda model: model.name)
def test_recorded_parameters_reproduce_the_recording(model: Model) -> None:
    pairs = pairs_of(model, DRIVERS)
    np.testing.assert_allclose(gap_rmse(model, DRIVERS, pairs), 0.0, atol=0.2)
    assert (gap_rmse(model, DRIVERS[::-1], pairs) > 0.5).all()


def test_fits_find_known_drivers() -> None:
    pairs = pairs_of(IDM, DRIVERS)
    each = fit_each(IDM, pairs, DRIVERS.mean(axis=0), seed=1, generations=60)
    assert (gap_rmse(IDM, each, pairs) < 0.4).all()
    np.testing.assert_allclose(each[:, 1], DRIVERS[:, 1], atol=0.3)  # the time gap is what pairs tell best
    np.testing.assert_array_equal(each, fit_each(IDM, pairs, DRIVERS.mean(axis=0), seed=1, generations=60))
    common = fit_common(IDM, pairs_of(IDM, DRIVERS[[0, 0]]), seed=1)
    assert gap_rmse(IDM, np.stack([common, common]), pairs_of(IDM, DRIVERS[[0, 0]])).max() < 0.4


def test_parts_of_pairs() -> None:
    pairs = pairs_of(IDM, DRIVERS)
    pairs.valid[1, 300:] = False
    later = pairs.part(0.6, 1.0)
    assert later.valid.sum(axis=1).tolist() == [200, 120]
    np.testing.assert_array_equal(later.gap[1, :120], pairs.gap[1, 180:300])


def test_drivers_are_split_not_stretches() -> None:
    pairs = pairs_of(IDM, DRIVERS[np.zeros(20, int)], steps=5)
    pairs = replace(pairs, follower=np.arange(20) // 4)
    held_in = calibration_run.split_by_driver(pairs, seed=0)
    assert not set(pairs.follower[held_in]) & set(pairs.follower[~held_in])
    assert held_in.sum() == 16  # 4 of 5 drivers


def test_lane_changes_are_counted_once() -> None:
    time = np.arange(0.0, 30.0, STEP_S)
    change = 1.83 + 3.66 / (1 + np.exp(-(time - 15.0)))
    assert count_lane_changes(change, 3.66) == 1
    assert count_lane_changes(np.concatenate([change, change[::-1]]), 3.66) == 2
    assert count_lane_changes(3.66 + 0.2 * np.sin(time), 3.66) == 0  # along the line


def test_absent_data(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="calibration needs it"):
        car_following(tmp_path)


def test_the_shipped_parameters() -> None:
    values = json.loads(PARAMETERS.read_text(encoding="utf-8"))
    assert values["provenance"]["seed"] == 0
    behaviour = calibrated()
    for site, drivers in behaviour.drivers.items():
        assert len(drivers) == values["car_following"]["IDM"]["held_in"][site]["pairs"]
        assert ((drivers >= IDM.low - 1e-3) & (drivers <= IDM.high + 1e-3)).all()
    assert PARAMETERS.stat().st_size < 50_000
    judged = values["car_following"]["IDM"]["held_out_gap_rmse_mean"]
    assert judged["common set"] < judged["published (ngsim_env)"]


def test_parameter_files_are_json_again(tmp_path: Path) -> None:
    values = {"a": {"b": [1, 2]}, "drivers": {"I-80": [[1.0, 2.0], [3.0, 4.0]], "US-101": [[5.0, 6.0]]}}
    calibration_run.write(values, tmp_path / "new" / "p.json")
    assert json.loads((tmp_path / "new" / "p.json").read_text()) == values


@pytest.mark.data
def test_the_real_pairs(real_data) -> None:
    pairs = car_following(real_data(I80_PAIRS).parents[1])
    assert set(pairs.name) == {"I-80", "US-101"}
    assert len(pairs) > 500
    steps = pairs.valid.sum(axis=1)
    assert steps.min() >= STEPS_MIN and steps.max() <= STEPS_MAX
    assert (pairs.gap[pairs.valid] > 0).all()
    moved = np.diff(pairs.position, axis=1)[pairs.valid[:, 1:]]
    speed = pairs.speed[:, 1:][pairs.valid[:, 1:]]
    assert np.median(np.abs(moved / STEP_S - speed)) < 0.2
    few = pairs.take(np.arange(0, len(pairs), 60))
    values = json.loads(PARAMETERS.read_text(encoding="utf-8"))["car_following"]["IDM"]["common"]
    common = np.broadcast_to(np.array([values[name] for name in IDM.parameters]), (len(few), 5))
    assert gap_rmse(IDM, common, few).mean() < 8.0
