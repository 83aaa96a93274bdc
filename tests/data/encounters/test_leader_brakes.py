from dataclasses import replace

import numpy as np

from litsim_data.encounters.lack import Lack
from litsim_data.encounters.leader_brakes import brakings
from made_encounters import following_track


def test_the_onset_is_when_the_leader_begins_to_lose_speed() -> None:
    (braking,) = brakings(following_track(begin=60))
    assert abs(braking.onset - 60) <= 2 and braking.lack is None
    assert (braking.frame, braking.history) == (1000 + braking.onset, 50)
    assert braking.name == f"i80_1600_2_{braking.frame}"


def test_history_is_the_longest_that_is_recorded() -> None:
    histories = [next(brakings(following_track(begin=begin, steps=230))).history for begin in (45, 80, 130)]
    assert histories == [30, 50, 100]


def test_what_lacks_for_an_encounter_is_told() -> None:
    track = following_track()
    closing = replace(track, speed=track.speed + 3.0)
    cases = {
        Lack.SHORT: following_track(begin=100),
        Lack.FAR: replace(track, leader_rear=track.leader_rear + 40.0),
        Lack.JUMP: replace(track, front=track.front + (np.arange(len(track)) == 70)),
        Lack.RECORD: following_track(begin=60, late=50),
        Lack.LOG: closing,
    }
    assert {lack: [braking.lack for braking in brakings(made)] for lack, made in cases.items()} == {
        lack: [lack] for lack in cases
    }


def test_an_earlier_onset_is_taken_if_the_log_has_more_room_from_there() -> None:
    track = following_track()
    seen = track.leader_speed - 3.0 * (np.arange(len(track)) >= 58)
    usual, earlier = (next(brakings(each)) for each in (track, replace(track, leader_speed=seen)))
    assert (usual.onset, earlier.onset, earlier.lack) == (60, 57, None)


def test_a_leader_that_keeps_its_speed_is_none() -> None:
    assert not list(brakings(following_track(begin=149)))
