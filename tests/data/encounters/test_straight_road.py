from dataclasses import replace

import numpy as np
import pytest

from litsim_data.encounters.leader_brakes import AFTER, brakings
from litsim_data.encounters.straight_road import encounter
from made_encounters import AGENT, OPPONENT, following_track


def test_the_log_keeps_both_at_their_pace_and_the_truth_is_kept_apart() -> None:
    made = encounter(next(brakings(following_track())))
    log, onset = made.scenario.log, made.note.onset_step
    assert (made.note.agent, made.note.opponent, len(made.truth)) == (AGENT, OPPONENT, onset + AFTER + 1)
    for vehicle in (AGENT, OPPONENT):
        row = log.row(vehicle)
        assert np.ptp(log.speed[row, onset:]) == 0.0
        assert np.allclose(np.diff(log.x[row, onset:]), 0.1 * log.speed[row, onset])
    assert made.truth.speed[-1] == pytest.approx(8.0, abs=0.01)
    assert made.opponent_truth.speed[-1] == pytest.approx(8.0, abs=0.01)


def test_what_people_did_comes_out_of_the_encounter() -> None:
    people = encounter(next(brakings(following_track(late=10)))).people
    assert people.onset == pytest.approx(1.3, abs=0.2)
    assert people.strongest_braking == pytest.approx(-2.0, abs=0.05)
    assert people.speed_lost == pytest.approx(4.0, abs=0.05)
    assert people.least_gap == pytest.approx(10.0 - 4.0, abs=0.1)


def test_nothing_that_can_be_seen_depends_on_what_is_recorded_later() -> None:
    braking, later = next(brakings(following_track())), np.maximum(np.arange(150) - 80, 0)
    track = braking.track
    other = replace(
        track,
        front=track.front - 0.1 * later,
        speed=np.maximum(track.speed - 0.1 * later, 0.0),
        leader_rear=track.leader_rear + 0.1 * later,
        leader_speed=track.leader_speed + 0.1 * later,
    )
    one, two = encounter(braking), encounter(replace(braking, track=other))
    until = 80 - braking.onset + braking.history + 1
    for name, values in one.scenario.recording.columns.items():
        assert np.array_equal(values, two.scenario.recording.columns[name])
    assert np.array_equal(one.opponent_truth.x[:until], two.opponent_truth.x[:until])
    assert one.truth.x[-1] - two.truth.x[-1] > 3.0


def test_an_unknown_leader_has_an_id_of_its_own() -> None:
    braking = next(brakings(replace(following_track(), leader=-1)))
    assert encounter(braking).note.opponent == 0
