"""Post-encroachment times of scenes with answers known in closed form."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_data.surrogates.encroachment import encroachments, times_since_others

Make = Callable[..., Any]


def test_pet_of_a_crossing(table: Make) -> None:
    # 1 is at the origin at step 20, 2 crosses it 1.5 s later; boxes 4 x 2 m at 10 m/s
    tables = [
        table(k, {"id": 1, "x": k - 20.0, "y": 0.0}, {"id": 2, "x": 0.0, "y": k - 35.0, "yaw": 1.5707963})
        for k in range(60)
    ]
    (found,) = encroachments(tables, 1)
    # the rear of 1 is past the flank of 2 when 1 is 3 m on, the front of 2 is at the flank of 1 3 m before: 1.5 - 0.6 s
    assert found.pet == pytest.approx(0.9, abs=0.21)
    assert (found.agent, found.first) == (2, 1)
    assert encroachments(tables, 2)[0].first == 1


def test_no_pet_in_parallel_lanes_or_much_later(table: Make) -> None:
    parallel = [table(k, {"id": 1, "x": 1.0 * k, "y": 0.0}, {"id": 2, "x": 1.0 * k, "y": 3.5}) for k in range(30)]
    assert encroachments(parallel, 1) == []
    late = [
        table(k, {"id": 1, "x": k - 20.0, "y": 0.0}, {"id": 2, "x": 0.0, "y": k - 90.0, "yaw": 1.5707963})
        for k in range(100)
    ]
    assert encroachments(late, 1) == []


def test_who_comes_only_after_the_other_has_left_the_road_encroaches_too(table: Make) -> None:
    # 1 leaves the road at the origin at step 20; 2, who was not there before, crosses it 1 s and 6 s later
    for later, expected in ((10, [(2, 1)]), (60, [])):
        tables = [
            table(k, {"id": 1, "x": k - 20.0, "y": 0.0})
            if k <= 20
            else table(k, {"id": 2, "x": 0.0, "y": k - 20.0 - later, "yaw": 1.5707963})
            for k in range(21 + later + 20)
        ]
        found = encroachments(tables, 1)
        assert [(each.agent, each.first) for each in found] == expected
        assert [each.pet for each in encroachments(tables, 2)] == [each.pet for each in found]
        second = times_since_others(tables)[0][21:]
        assert second.min() == (found[0].pet if found else np.inf)


def test_step_by_step_the_second_learns_how_long_ago_the_first_was_there(table: Make) -> None:
    tables = [
        table(k, {"id": 1, "x": k - 20.0, "y": 0.0}, {"id": 2, "x": 0.0, "y": k - 35.0, "yaw": 1.5707963})
        for k in range(60)
    ]
    since, others = (values.reshape(60, 2) for values in times_since_others(tables))
    (pair,) = encroachments(tables, 1)
    assert np.isinf(since[:, 0]).all()  # 1 comes first and meets nobody's past
    assert since[:, 1].min() == pair.pet
    assert since[pair.step, 1] == pair.pet
    assert np.isinf(since[: pair.step, 1]).all()
    assert (others == -1).tolist() == np.isinf(since).tolist()
    assert set(others[:, 1]) == {-1, 1}


def test_step_by_step_the_shortest_is_that_of_the_pairs_in_which_an_agent_comes_second(table: Make) -> None:
    random = np.random.default_rng(3)
    start, yaw = random.uniform(-30.0, 30.0, (12, 2)), random.uniform(-3.1, 3.1, 12)
    tables = [
        table(
            k,
            *({"id": i, "x": x + k * np.cos(a), "y": y + k * np.sin(a), "yaw": a} for i, (x, y, a) in enumerate(rows)),
        )
        for k, rows in enumerate([list(zip(*start.T, yaw, strict=True))] * 60)
    ]
    told = times_since_others(tables)[0].reshape(60, 12).min(axis=0)
    expected = np.full(12, np.inf)
    for agent in range(12):
        for found in encroachments(tables, agent):
            second = found.agent if found.first == agent else agent
            expected[second] = min(expected[second], found.pet)
            if found.pet == 0.0:
                expected[agent] = 0.0
    assert told.tolist() == expected.tolist()
    assert np.isfinite(told).any()


def test_agents_that_are_nowhere_meet_nobody(table: Make) -> None:
    tables = [table(k, {"id": 1, "x": np.nan, "y": 0.0}, {"id": 2, "x": 0.0, "y": 0.0}) for k in range(2)]
    assert times_since_others(tables)[0].tolist() == [np.inf] * 4
    assert [values.tolist() for values in times_since_others([table(0)])] == [[], []]


def test_of_several_at_the_same_age_the_lowest_id_counts(table: Make) -> None:
    tables = [
        table(
            k,
            {"id": 3, "x": -0.5, "y": 0.0 if k == 0 else 50.0},
            {"id": 7, "x": -1.0, "y": 0.0 if k == 0 else -50.0},
            {"id": 9, "x": 20.0 - 20.0 * k, "y": 0.0},
        )
        for k in range(2)
    ]
    since, others = times_since_others(tables)
    assert (since[5], others[5]) == (pytest.approx(0.1), 3), "both have been there a step ago"
    assert (since[0], others[0]) == (0.0, 7), "they touch"
