"""The car following fitted to recorded followers: it comes back from made ones, and is what ships from real ones."""

import numpy as np
import pytest

from litsim_data.encounters.following import PAIRS, FollowingTrack, following_tracks
from litsim_policy.driving.follower import FollowerConfig
from litsim_policy.motion.car_following import IdmValues, following
from litsim_policy.motion.log_leaders import BACK
from litsim_research.reactions.calibrate import errors, fit
from litsim_research.reactions.starts import STEPS, Starts, headway_spread, headways_of
from litsim_sim.core.scene import STEP_S

TRUE = IdmValues(1.2, 2.5, 0.9, 1.6, 3.0)


def made(number: int, headway: float, steps: int = 240) -> FollowingTrack:
    """A follower with its own `headway` [s] behind a leader whose speed swings."""
    time = STEP_S * np.arange(steps)
    lead = 9.0 + 2.5 * np.sin((0.3 + 0.04 * number) * time + number)
    rear = 20.0 + STEP_S * np.cumsum(lead)
    front, speed = np.zeros(steps), np.full(steps, 9.0)
    for k in range(steps - 1):
        slows = (lead[k] - lead[max(k - BACK, 0)]) / (BACK * STEP_S)
        wanted = following(speed[k], rear[k] - front[k], lead[k], slows, TRUE._replace(headway=headway))
        speed[k + 1] = max(speed[k] + STEP_S * wanted, 0.0)
        front[k + 1] = front[k] + 0.5 * STEP_S * (speed[k] + speed[k + 1])
    return FollowingTrack("made", 0, number, -1, 4.5, 0, front, speed, rear, lead)


@pytest.fixture(scope="module")
def starts() -> Starts:
    """Of sixteen drivers."""
    return Starts.of(made(number, headway) for number, headway in enumerate(np.linspace(0.8, 2.0, 16).tolist()))


def test_starts_tell_what_people_did_and_what_was_known(starts: Starts) -> None:
    assert starts.front.shape == starts.leader_rear.shape == (len(starts), STEPS + 1)
    assert (starts.front[:, 0] == 0.0).all() and 0 < starts.brakes.sum() < len(starts)
    assert (starts.looks[0, 2:] == 0.0).all(), "nothing is known of the time before the track"


def test_drivers_come_back(starts: Starts) -> None:
    found = fit(starts, own_headway=True)
    front, _ = found.drive(starts)
    alike, _ = fit(starts, own_headway=False).drive(starts)
    assert errors(starts, front).mean() < 0.5 * errors(starts, alike).mean()
    known = headways_of(starts, found.model, found.looks)[starts.looks[:, -1, 0] > 0.0]
    assert known.min() < 1.0 and known.max() > 1.8


def test_drivers_who_keep_their_headways_spread_little_around_them(starts: Starts) -> None:
    unknown = Starts(**{**vars(starts), "looks": np.zeros_like(starts.looks)})
    assert headway_spread(starts, TRUE, 0.5) < 0.6 * headway_spread(unknown, TRUE, 0.5)


def test_the_car_following_that_ships_is_that_of_the_command(real_data) -> None:
    """Rounded, so a little worse."""
    data = real_data(PAIRS).parents[1]
    starts = Starts.of(track for track in following_tracks(data) if track.split == "tuning")
    found, ships = fit(starts, own_headway=True), FollowerConfig()
    for field, value in found._asdict().items():
        assert getattr(ships, field) == pytest.approx(value, rel=0.02), field
    assert ships.spread.headway == pytest.approx(headway_spread(starts, found.model, found.looks), rel=0.02)
