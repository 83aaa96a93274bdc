"""Training of the density of speed changes, on made followers."""

import numpy as np
import pytest

from litsim_data.encounters.following import FollowingTrack
from litsim_policy.motion.speed_change import INPUTS, USUAL_HEADWAY, Situation, load_speed_change, log_chance

torch = pytest.importorskip("torch")

from litsim_research.reactions.samples import samples_of  # noqa: E402
from litsim_research.reactions.train import fit, gaussian_loss, mean_loss, parted, save  # noqa: E402


def follower(number: int, steps: int = 200) -> FollowingTrack:
    """A follower that keeps 1 s behind a leader whose speed swings, and takes on its speed 1 s later."""
    time = 0.1 * np.arange(steps)
    leader_speed = 10.0 + 2.0 * np.sin(0.5 * time + number)
    speed = 10.0 + 2.0 * np.sin(0.5 * (time - 1.0) + number)
    rear, front = 20.0 + 0.1 * np.cumsum(leader_speed), 8.0 + 0.1 * np.cumsum(speed)
    return FollowingTrack("made", 0, number, -1, 4.5, 0, front, speed, rear, leader_speed)


def test_samples_tell_the_change_within_a_second_and_what_was_known_before() -> None:
    track = follower(0)
    samples = samples_of([track])
    assert samples.features.shape == (len(samples), INPUTS)
    assert samples.change[0] == pytest.approx(track.speed[15] - track.speed[5], abs=0.05)
    headway = USUAL_HEADWAY + samples.features[:, 6]
    assert headway[0] > headway[-1] and headway[-1] == pytest.approx(1.25, abs=0.15)


def test_a_network_learns_what_followers_do_and_drives_as_it_was_saved(tmp_path) -> None:
    samples = samples_of(follower(number) for number in range(6))
    network = fit(samples, 150, seed=0)
    assert mean_loss([network], samples) < gaussian_loss(samples, samples) - 0.3
    save([network, network], tmp_path / "two.safetensors", {})
    density = load_speed_change(tmp_path / "two.safetensors")
    slows, gains = Situation(10.0, 10.0, 2.0, -1.0, 1.2), Situation(10.0, 10.0, -2.0, 1.0, 1.2)
    assert log_chance(0.0, slows, density) < log_chance(0.0, gains, density)


def test_the_followers_that_tell_how_well_are_not_fitted_to() -> None:
    tracks = [follower(number) for number in range(60) for _ in range(2)]
    fitted, held_back = parted(tracks)
    assert len(fitted) + len(held_back) == 120 and held_back
    assert not {track.follower for track in fitted} & {track.follower for track in held_back}
