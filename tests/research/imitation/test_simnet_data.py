"""What SimNet learns from: rasters of agents and where they went, and the displaced ones' way back."""

from typing import Any

import numpy as np
import pytest

from litsim_research.baselines.simnet.output import FUTURE, OUTPUTS
from litsim_research.baselines.simnet.raster import CHANNELS, FRAMES, OWN, SMALL
from litsim_research.imitation.simnet_data import (
    FUTURE_S,
    PAST_S,
    RASTERS_MAX,
    UNIT_MIN,
    Moments,
    PerturbationConfig,
    Samples,
    perturbed,
    relative,
)
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, Kind

SPEED = 10.0


def straight(yaw: float, times: np.ndarray, agents: int = 1) -> np.ndarray:
    """Poses (agents, times, 3) on a straight way through the origin at SPEED."""
    gone = SPEED * times
    pose = np.stack([gone * np.cos(yaw), gone * np.sin(yaw), np.full(len(gone), yaw)], axis=-1)
    return np.tile(pose, (agents, 1, 1))


@pytest.mark.parametrize("yaw", [0.0, 3.1, -1.2])
def test_futures_are_seen_from_the_agent(yaw: float) -> None:
    future = straight(yaw, FUTURE_S)
    future[0, :, 2] += 0.1  # beyond half a turn where it drives to the west
    ahead, left, turn = relative(np.array([[0.0, 0.0, yaw]]), future).reshape(FUTURE, 3).T
    assert ahead == pytest.approx(SPEED * FUTURE_S) and left == pytest.approx(0.0, abs=1e-9)
    assert turn == pytest.approx(0.1)


def test_who_is_drawn_and_what_it_does(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(
        track(1, x=150.0, speed=SPEED, last=40),
        track(2, x=120.0, speed=SPEED, last=40),
        track(3, x=90.0, speed=SPEED, last=10),  # gone too soon
        track(4, x=60.0, speed=2.0, last=40, kind=Kind.BICYCLE),  # never driven
    )
    samples = Moments([scenario], [1.0]).draw(40, 8, np.random.default_rng(0))
    rasters, futures = samples.rasters, samples.futures
    assert rasters.shape == (len(futures), CHANNELS, SMALL.rows, SMALL.columns) and futures.shape[1] == OUTPUTS
    assert len(futures) <= 80  # two at a moment at most
    ahead, left, turn = futures.reshape(-1, FUTURE, 3).transpose(2, 0, 1)
    assert ahead == pytest.approx(np.tile(SPEED * FUTURE_S, (len(futures), 1)), abs=1e-6)
    assert np.abs(left).max() < 1e-6 and np.abs(turn).max() < 1e-9
    assert rasters[:, OWN + FRAMES - 1].any(axis=(1, 2)).all()
    # at the first steps of the log there is no history
    assert 0.0 < (~rasters[:, OWN].any(axis=(1, 2))).mean() < 0.5
    assert np.array_equal(samples.known, rasters[:, OWN + FRAMES - 2].any(axis=(1, 2)))
    assert samples.way == pytest.approx(np.where(samples.known, SPEED * STEP_S, 0.0))
    assert samples.units == pytest.approx(UNIT_MIN)  # nobody does anything


def test_rasters_that_no_memory_holds_are_refused_and_units_need_none(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(*(track(k, x=60.0 + 20.0 * k, speed=SPEED, last=40) for k in range(1, 4)))
    moments, raster = Moments([scenario], [1.0]), 4 * CHANNELS * SMALL.rows * SMALL.columns
    fit = RASTERS_MAX // raster
    with pytest.raises(
        InputError, match=f"{fit} moments of up to 3 agents are {3 * fit} rasters, expected at most {fit}"
    ):
        moments.draw(fit, 1000, np.random.default_rng(0))
    drawn, alone = (moments.draw(40, 1000, np.random.default_rng(0), painted=each) for each in (True, False))
    assert alone.rasters.nbytes < raster
    for name in ("futures", "way", "known"):
        assert np.array_equal(getattr(drawn, name), getattr(alone, name))


def test_errors_are_counted_in_what_people_do() -> None:
    """Of two, one speeds up by 1 m/s2 and turns by 0.1 rad/s; of the third it is not known how fast it was."""
    futures = np.zeros((3, FUTURE, 3))
    futures[0, :, 0] = SPEED * FUTURE_S + 0.5 * FUTURE_S**2
    futures[0, :, 2] = 0.1 * FUTURE_S
    futures[1:, :, 0] = SPEED * FUTURE_S
    way, known = np.array([1.0, 1.0, 0.0]), np.array([True, True, False])
    units = Samples(np.empty(0, np.float32), futures.reshape(3, OUTPUTS), way, known).units.reshape(FUTURE, 3)
    assert units[:, 0] == pytest.approx(0.5 * FUTURE_S**2 / np.sqrt(2.0))
    assert units[:, 2] == pytest.approx(0.1 * FUTURE_S / np.sqrt(2.0))


def test_nobody_to_learn_from(make_scenario: Any, track: Any) -> None:
    with pytest.raises(InputError, match="no vehicle is on the road for 13 steps"):
        Moments([make_scenario(track(1, x=50.0, last=FUTURE - 1))], [1.0])


def test_the_displaced_come_back_smoothly() -> None:
    config = PerturbationConfig(share=1.0, back_s=0.25, along_back_s=0.25)
    past, future = straight(0.4, PAST_S, 500), straight(0.4, FUTURE_S, 500)
    own, then = perturbed(past, future, np.full(500, SPEED), config, np.random.default_rng(0))

    def across(pose: np.ndarray) -> np.ndarray:
        return pose[..., 1] * np.cos(0.4) - pose[..., 0] * np.sin(0.4)

    def along(pose: np.ndarray) -> np.ndarray:
        return pose[..., 0] * np.cos(0.4) + pose[..., 1] * np.sin(0.4)

    offset, ahead = across(own)[:, -1], along(own)[:, -1]
    assert offset.std() == pytest.approx(config.offset, rel=0.1) and ahead.std() == pytest.approx(config.ahead, rel=0.1)
    assert np.abs(along(then)[:, -1] - SPEED * FUTURE_S[-1]).mean() < 0.2 * np.abs(ahead).mean()
    assert (own[:, -1, 2] - 0.4).std() == pytest.approx(config.turn, rel=0.1)
    assert np.abs(across(then)[:, -1]).mean() < 0.2 * np.abs(offset).mean()
    way = np.concatenate([own, then], axis=1)
    gone = np.hypot(*np.diff(way[..., :2], axis=1).transpose(2, 0, 1)) / STEP_S
    assert gone[:, 0].std() == pytest.approx(config.speed, rel=0.1)
    assert np.abs(gone[:, -1] - SPEED).mean() < 0.5 * np.abs(gone[:, 0] - SPEED).mean()
    # it drives where it looks: the way of a step is along the mean of the headings at its ends
    course = np.arctan2(*np.diff(way[..., :2], axis=1).transpose(2, 0, 1)[::-1])
    heading = 0.5 * (way[:, 1:, 2] + way[:, :-1, 2])
    assert np.quantile(np.abs(course - heading), 0.99) < 0.05


def test_the_slow_and_the_others_are_left_as_they_are() -> None:
    past, future = straight(0.0, PAST_S, 400), straight(0.0, FUTURE_S, 400)
    own, then = perturbed(past, future, np.full(400, 1.0), PerturbationConfig(share=1.0), np.random.default_rng(0))
    assert np.array_equal(own, past) and np.array_equal(then, future)
    own, _ = perturbed(past, future, np.full(400, SPEED), PerturbationConfig(share=0.25), np.random.default_rng(0))
    assert (np.abs(own - past).max(axis=(1, 2)) > 0).mean() == pytest.approx(0.25, abs=0.06)
