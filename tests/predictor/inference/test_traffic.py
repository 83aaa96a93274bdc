"""The traffic ahead: how fast it drives and whether there is any, lane by lane and place by place."""

from collections.abc import Callable

import numpy as np
import pytest

from litsim_predictor.forecast import Float32Array
from litsim_predictor.inference.joint.units import TRAFFIC_KNOTS, TRAFFIC_SOME
from litsim_predictor.inference.traffic import Traffic
from litsim_sim.core.history import History
from litsim_sim.core.scene import AgentTable, Kind

Build = Callable[..., AgentTable]
PLACES = len(TRAFFIC_KNOTS) - 2
FASTER, GAINED, MANY = 0, 1, 2
LANE, ALL_LANES = 0, 1


def traffic(*agents: tuple[float, ...], begins: tuple[int, ...] = (0,)) -> Float32Array:
    """(n, lanes, places, what) of agents at x, y [m], heading [rad], speed now and, where known, a second ago [m/s]."""
    table = np.array([(*agent, np.nan)[:5] for agent in agents])
    speed, earlier = table[:, 3:].T.astype(np.float32)
    pose, scene = np.ascontiguousarray(table[:, :3]), np.searchsorted(begins, np.arange(len(table)), "right") - 1
    found = Traffic(pose, speed, earlier, np.isfinite(earlier), scene).ahead_of(pose, speed, scene)
    return found.reshape(len(agents), 2, PLACES, 3)


def test_one_who_is_alone_sees_nothing() -> None:
    assert not traffic((5.0, 3.0, 1.0, 9.0)).any()


def test_a_vehicle_at_a_knot_counts_there_alone_and_only_for_those_behind_it() -> None:
    for place, knot in enumerate(TRAFFIC_KNOTS[1:-1]):
        first, last = traffic((0.0, 0.0, 0.0, 10.0), (knot, 0.0, 0.0, 4.0))
        expected = np.zeros((2, PLACES, 3))
        expected[:, place] = -6.0 / (1.0 + TRAFFIC_SOME), 0.0, 1.0
        assert first == pytest.approx(expected, abs=1e-5)
        assert not last.any()


def test_between_two_knots_it_counts_at_both() -> None:
    near, far = TRAFFIC_KNOTS[1:3]
    here = traffic((0.0, 0.0, 0.0, 10.0), (near + 0.25 * (far - near), 0.0, 0.0, 12.0))[0, LANE]
    assert here[:2, MANY] == pytest.approx([0.75, 0.25])
    assert here[:2, FASTER] == pytest.approx([1.5 / (0.75 + TRAFFIC_SOME), 0.5 / (0.25 + TRAFFIC_SOME)])


def test_what_they_have_gained_is_a_mean_of_those_who_were_seen() -> None:
    braking, new = (25.0, 0.0, 0.0, 8.0, 11.0), (25.0, 0.0, 0.0, 8.0)
    one, both, nobody = (traffic((0.0, 0.0, 0.0, 10.0), *who)[0, LANE, 0] for who in ([braking], [braking, new], [new]))
    assert one[GAINED] == pytest.approx(-3.0 / (1.0 + TRAFFIC_SOME))
    assert both[GAINED] == one[GAINED] and both[FASTER] < one[FASTER]
    assert nobody[GAINED] == 0.0 and nobody[FASTER] < 0.0


def test_the_next_lane_is_no_part_of_ones_own() -> None:
    beside = traffic((0.0, 0.0, 0.0, 10.0), (25.0, 3.66, 0.0, 4.0))[0]
    assert not beside[LANE].any()
    assert beside[ALL_LANES, 0, FASTER] < -4.0


def test_many_in_a_place_have_a_mean_and_count_as_one() -> None:
    jam = [(25.0, -3.66 * lane, 0.0, 2.0 + lane) for lane in range(4)]
    ahead = traffic((0.0, 0.0, 0.0, 10.0), *jam)[0, ALL_LANES, 0]
    assert -6.5 < ahead[FASTER] < -5.0
    assert ahead[MANY] == 1.0


def test_oncoming_and_crossing_traffic_does_not_count() -> None:
    assert not traffic((0.0, 0.0, 0.0, 10.0), (25.0, 0.0, np.pi, 10.0), (60.0, 0.0, 0.5 * np.pi + 0.01, 5.0))[0].any()


def test_whoever_drives_elsewhere_sees_the_same() -> None:
    turn = 0.7
    cos, sin = np.cos(turn), np.sin(turn)
    here = [(0.0, 0.0, 0.0, 10.0), (40.0, 1.0, 0.1, 4.0), (110.0, -8.0, -0.1, 12.0)]
    there = [(5e5 + cos * x - sin * y, sin * x + cos * y - 2e5, yaw + turn, speed) for x, y, yaw, speed in here]
    assert traffic(*there) == pytest.approx(traffic(*here), abs=1e-3)


def test_scenes_do_not_see_each_other() -> None:
    one = [(0.0, 0.0, 0.0, 10.0), (30.0, 0.0, 0.0, 4.0)]
    other = [(10.0, 0.0, 0.0, 3.0), (70.0, 1.0, 0.0, 9.0), (90.0, 0.0, 0.0, 9.0)]
    both = traffic(*one, *other, begins=(0, 2))
    assert np.array_equal(both, np.concatenate([traffic(*one), traffic(*other)]))


def test_nothing_jumps_while_a_vehicle_passes() -> None:
    """Neither along the road nor across it: a step of 0.1 m changes little."""
    along = [traffic((0.0, 0.0, 0.0, 10.0), (x, 0.5, 0.0, 0.0))[0] for x in np.arange(-5.0, 250.0, 0.1)]
    across = [traffic((0.0, 0.0, 0.0, 10.0), (50.0, y, 0.0, 0.0))[0] for y in np.arange(-40.0, 40.0, 0.1)]
    for passing in (along, across):
        step = np.abs(np.diff(passing, axis=0))
        assert step[..., MANY].max() < 0.05 and step[..., FASTER].max() < 1.2


def test_vehicles_of_a_running_scene_are_read_with_their_speeds_of_a_second_ago(agent_table: Build) -> None:
    history = History(20, ("x", "y", "yaw", "speed"))
    for step in range(12):
        later = [{"id": 5, "x": 60.0, "yaw": 0.1, "speed": 4.0}] if step > 4 else []
        people = [{"id": 6, "x": 25.0, "speed": 1.0, "kind": Kind.PEDESTRIAN}]
        table = agent_table(step, {"id": 2, "x": 25.0, "y": 1.0, "speed": 12.0 - 0.3 * step}, *later, *people)
        history.push(table)
    found = Traffic.of_table(table, history)
    assert found.pose.tolist() == [[25.0, 1.0, 0.0], [60.0, 0.0, 0.1]]
    assert found.speed == pytest.approx([8.7, 4.0]) and found.seen.tolist() == [True, False]
    assert found.earlier[0] == pytest.approx(12.0 - 0.3 * 1)
    assert found.scene.tolist() == [0, 0]


def test_of_many_vehicles_those_far_away_change_nothing() -> None:
    """Vehicles in any order, some hundred metres around: none is passed over that counts."""
    random = np.random.default_rng(6)
    place, heading = random.uniform(-300.0, 300.0, (150, 2)) * [1.0, 0.2], random.normal(0.0, 1.0, 150)
    agents = np.column_stack([place, heading, random.uniform(0.0, 20.0, (150, 2))])
    everybody = traffic(*agents.tolist())
    for i, (x, y, turn, *_) in enumerate(agents.tolist()):
        dx, dy = agents[:, 0] - x, agents[:, 1] - y
        ahead, left = np.cos(turn) * dx + np.sin(turn) * dy, np.cos(turn) * dy - np.sin(turn) * dx
        near = (ahead > -1.0) & (ahead < 241.0) & (np.abs(left) < 31.0)
        some = traffic(*agents[near].tolist())
        np.testing.assert_array_equal(everybody[i], some[near[:i].sum()])
    assert everybody[..., MANY].any()
