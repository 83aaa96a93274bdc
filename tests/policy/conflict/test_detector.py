"""Conflict detection: one golden situation per verdict, against shapely and against Monte Carlo."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from litsim_policy.conflict import overlap
from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.detector import (
    FOLLOWED,
    Conflict,
    ConflictDetector,
    followed,
    pairs_in_region,
)
from litsim_policy.conflict.futures import Futures
from litsim_policy.conflict.predicted_motion import XX, YAW, PredictedMotion, X, Y
from litsim_predictor.forecast import Forecast, Modes
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import box_corners, to_body
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.scene import STEP_S, AgentTable
from litsim_sim.scenario.log import Log
from made_agents import agent_arrays, straight_on

DT = 0.2  # [s] between instants of the forecasts here
NOW = 5  # step at which agents are looked at
LENGTH, WIDTH = 4.5, 2.0  # [m] of everybody


def still_in_conflict(detector: ConflictDetector, futures: Futures, agents: np.ndarray, off: np.ndarray) -> np.ndarray:
    return detector.still_in_conflict(futures, detector.pairs(futures, agents, off))


@dataclass(frozen=True)
class Situation:
    """What one detection looks at; the agents of the mask `off` are off their logs."""

    detector: ConflictDetector
    table: AgentTable
    off: np.ndarray
    forecast: Forecast

    @property
    def futures(self) -> Futures:
        """Those of all agents."""
        futures, everybody = self.uncovered, np.ones(len(self.table), np.bool_)
        futures.cover(everybody, everybody)
        return futures

    @property
    def uncovered(self) -> Futures:
        return Futures(self.detector.log, self.detector.config, self.table, self.forecast)

    def conflicts(self) -> list[Conflict]:
        return self.detector.conflicts(self.uncovered, ~self.off, self.off)

    def probability(self, least: float) -> np.ndarray:
        """Probabilities (m, T) of the pairs of an agent on its log with one that is off its log."""
        return self.detector.pair_probabilities(self.uncovered, ~self.off, self.off, least)[1]

    def still(self) -> np.ndarray:
        """Ids of the agents on their logs that would remain in conflict if they were off."""
        return self.table.id[still_in_conflict(self.detector, self.uncovered, ~self.off, self.off)]


def situation(log: Log, table: AgentTable, *off: int, roi_m: float = 30.0, **config: float) -> Situation:
    """The mean of the forecast alone counts, if not told otherwise."""
    detector = ConflictDetector(log, roi_m, ConflictConfig(**{"sigma_scale": 0.0} | config))
    return Situation(detector, table, np.isin(table.id, off), straight_on(table))


@pytest.fixture
def look(make_scenario, track, placed, lane_centres):
    """Looks at NOW at an ego, agent 1, that is elsewhere than in its log, among vehicles on their logs.

    The ego is at x = 100 in lane 1, at 10 m/s if not told otherwise.
    """

    def at_now(*others: dict[str, Any], ego: dict[str, float] | None = None, **config: float) -> Situation:
        tracks = []
        for fields in others:
            begin = dict(fields)
            speed, yaw = begin.get("speed", 10.0), begin.get("yaw", 0.0)
            begin["x"] = begin["x"] - 0.1 * NOW * speed * np.cos(yaw)
            begin["y"] = begin.get("y", lane_centres[1]) - 0.1 * NOW * speed * np.sin(yaw)
            tracks.append(track(**begin))
        log = make_scenario(track(1, x=300.0), *tracks).log
        where = {"x": 100.0, "y": lane_centres[1], "yaw": 0.0, "speed": 10.0} | (ego or {})
        return situation(log, placed(log.table(NOW), 1, **where), 1, **config)

    return at_now


def boxes_at(scene: Situation, agent: int, future: PredictedMotion) -> list[shapely.Polygon]:
    """The box of `agent` at every instant of `future`."""
    row = scene.table.row(agent)
    size = np.full(future.x.shape[1], scene.table.length[row]), np.full(future.x.shape[1], scene.table.width[row])
    return [shapely.Polygon(c) for c in box_corners(future.x[row], future.y[row], future.yaw[row], *size)]


# Verdicts of the detector


def test_a_follower_whose_log_runs_into_a_slower_ego_is_in_conflict(look, lane_centres) -> None:
    (conflict,) = look({"id": 2, "x": 85.0, "speed": 10.0}, ego={"speed": 4.0}).conflicts()
    # 15 m apart, bumpers 10.5 m, closing at 6 m/s: contact after 1.75 s, in the ninth instant
    assert (conflict.agent, conflict.opponent) == (2, 1)
    assert conflict.time_to_conflict == pytest.approx(1.8)
    assert conflict.pose == pytest.approx([85.0 + 18.0, lane_centres[1], 0.0])


def test_a_leader_that_the_ego_runs_into_is_in_none(look) -> None:
    scene = look({"id": 2, "x": 112.0, "speed": 4.0}, ego={"speed": 12.0})
    assert scene.probability(0.5).max() == 1.0, "they would touch, if nobody did anything"
    assert scene.conflicts() == []


def test_a_leader_that_cuts_in_right_before_the_ego_is_in_conflict(look, lane_centres) -> None:
    """It is not yet ahead in the strip that the ego sweeps: it can still stay where it is."""
    scene = look({"id": 2, "x": 103.0, "y": lane_centres[0], "speed": 8.0, "yaw": -0.15}, ego={"speed": 10.0})
    assert [c.agent for c in scene.conflicts()] == [2]


@pytest.mark.parametrize(("lane", "yaw", "found"), [(0, -0.25, [2]), (1, 0.0, [])])
def test_only_a_leader_in_the_strip_that_the_ego_sweeps_is_followed(look, lane_centres, lane, yaw, found) -> None:
    """Ahead, but in the next lane: one that comes over is not somebody whom the ego has been following."""
    ahead = {"id": 2, "x": 109.0, "y": lane_centres[lane], "speed": 5.0, "yaw": yaw, "last": 25}
    assert [c.agent for c in look(ahead, ego={"speed": 12.0}).conflicts()] == found


def test_who_comes_towards_the_ego_is_no_leader_of_it(look, lane_centres) -> None:
    """As an oncoming vehicle does whose way an ego that turns left, or stops there, is in."""
    oncoming = {"id": 2, "x": 125.0, "y": lane_centres[1] + 1.0, "speed": 8.0, "yaw": math.pi}
    (conflict,) = look(oncoming, ego={"speed": 0.0}).conflicts()
    assert (conflict.agent, conflict.opponent) == (2, 1)
    # 25 m apart, bumpers 20.5 m, at 8 m/s
    assert conflict.time_to_conflict == pytest.approx(2.6, abs=0.11)


def test_agents_outside_of_the_region_of_interest_are_not_looked_at(look) -> None:
    fast = {"id": 2, "x": 65.0, "speed": 25.0}

    def found(roi_m: float, approach_time: float) -> list[int]:
        return [c.agent for c in look(fast, ego={"speed": 4.0}, roi_m=roi_m, approach_time=approach_time).conflicts()]

    assert found(34.9, 0.0) == []
    assert found(35.1, 0.0) == [2]
    assert found(30.0, 0.2) == [], "35 m away, it comes nearer by 21 m/s"
    assert found(30.0, 0.3) == [2]


def test_conflicts_beyond_the_horizon_are_not_believed(look) -> None:
    late = {"id": 2, "x": 76.0, "speed": 10.0}  # contact after 3.25 s
    assert look(late, ego={"speed": 4.0}, horizon=3.0).conflicts() == []
    (conflict,) = look(late, ego={"speed": 4.0}, horizon=3.5).conflicts()
    assert conflict.time_to_conflict == pytest.approx(3.3)


def test_a_margin_lengthens_the_boxes(look) -> None:
    near = {"id": 2, "x": 95.0, "speed": 10.0}  # half a metre behind, and no faster
    assert look(near).conflicts() == []
    assert [c.agent for c in look(near, margin=0.6).conflicts()] == [2]


def test_a_lagged_log_is_not_expected_to_go_on_as_it_moves_now(look) -> None:
    """Its recorded acceleration may be noise."""
    beside = look({"id": 2, "x": 90.0}, ego={"acceleration": -8.0})
    follows_log = Futures(
        beside.detector.log, ConflictConfig(), beside.table, beside.forecast, keep_to_log=beside.table.id == 1
    )
    assert beside.conflicts()[0].urgent
    assert not any(c.urgent for c in beside.detector.conflicts(follows_log, ~beside.off, beside.off))


def test_a_log_that_is_over_by_then_is_in_none(look) -> None:
    leaves = {"id": 2, "x": 85.0, "speed": 10.0, "last": NOW + 15}
    assert look(leaves, ego={"speed": 4.0}).conflicts() == []
    stays = {"id": 2, "x": 85.0, "speed": 10.0, "last": NOW + 18}
    assert len(look(stays, ego={"speed": 4.0}).conflicts()) == 1


def test_an_ego_without_a_forecast_is_in_none(look) -> None:
    found = look({"id": 2, "x": 85.0, "speed": 10.0}, ego={"speed": 4.0})
    unknown = straight_on(found.table)
    unknown.valid[found.table.row(1)] = False
    assert len(found.conflicts()) == 1 and replace(found, forecast=unknown).conflicts() == []


def test_the_soonest_conflict_comes_first_and_every_agent_once(look, lane_centres) -> None:
    scene = look(
        {"id": 4, "x": 85.0, "speed": 10.0},
        {"id": 3, "x": 90.0, "y": lane_centres[0], "speed": 14.0, "yaw": -0.2},
        {"id": 2, "x": 120.0, "y": lane_centres[4]},
        ego={"speed": 3.0},
    )
    # as if the ego and the one in lane 4 were both off their logs; the latter crosses nobody's way
    conflicts = replace(scene, off=np.isin(scene.table.id, [1, 2])).conflicts()
    assert [c.agent for c in conflicts] == [3, 4]
    assert conflicts[0].time_to_conflict < conflicts[1].time_to_conflict


def test_of_two_opponents_the_one_that_is_met_first_is_named(look, placed, lane_centres) -> None:
    aside = {"id": 3, "x": 92.0, "y": lane_centres[3], "speed": 5.0}
    scene = look({"id": 2, "x": 82.0, "speed": 12.0}, aside, ego={"speed": 0.0})
    table = placed(scene.table, 3, y=lane_centres[1])
    (conflict,) = replace(scene, table=table, forecast=straight_on(table), off=np.isin(table.id, [1, 3])).conflicts()
    assert (conflict.agent, conflict.opponent) == (2, 3)


def test_background_that_overlaps_in_the_log_as_well_is_not_in_conflict(look) -> None:
    """Agent 2 drives into 3 in the log itself; it does not drive into the ego there."""
    scene = look({"id": 2, "x": 82.0, "speed": 12.0}, {"id": 3, "x": 92.0, "speed": 5.0}, ego={"speed": 0.0})
    (conflict,) = replace(scene, off=np.isin(scene.table.id, [1, 3])).conflicts()
    assert (conflict.agent, conflict.opponent) == (2, 1)


def test_background_meets_background_that_is_off_its_log(look, lane_centres) -> None:
    scene = look({"id": 2, "x": 60.0, "y": lane_centres[3], "speed": 10.0}, {"id": 3, "x": 75.0, "y": lane_centres[3]})
    assert scene.conflicts() == [], "both on their logs: theirs to sort out"
    stopped = scene.table.speed.copy()
    stopped[scene.table.row(3)] = 2.0
    table = replace(scene.table, speed=stopped)
    forecast = straight_on(table)
    (conflict,) = replace(scene, table=table, off=np.isin(table.id, [1, 3]), forecast=forecast).conflicts()
    assert (conflict.agent, conflict.opponent) == (2, 3)


crowd = st.lists(
    st.tuples(st.floats(60, 140), st.floats(-18, 0), st.floats(-0.4, 0.4), st.floats(0, 20), st.booleans()),
    min_size=2,
    max_size=7,
)


def plain_log(table: AgentTable, steps: int = 60) -> Log:
    """Everybody drives straight on from `table`, which is at step 0."""
    t = 0.1 * np.arange(steps)
    cos, sin = np.cos(table.yaw)[:, None], np.sin(table.yaw)[:, None]
    still = np.zeros((len(table), steps))
    return Log(
        ids=table.id,
        kind=table.kind,
        length=table.length,
        width=table.width,
        first_step=np.zeros(len(table), np.int64),
        last_step=np.full(len(table), steps - 1),
        valid=np.ones((len(table), steps), np.bool_),
        x=table.x[:, None] + table.speed[:, None] * t * cos,
        y=table.y[:, None] + table.speed[:, None] * t * sin,
        yaw=still + table.yaw[:, None],
        speed=still + table.speed[:, None],
        acceleration=still,
        yaw_rate=still,
    )


@settings(max_examples=60)
@given(crowd)
def test_every_conflict_is_an_overlap_that_shapely_sees_and_none_comes_earlier(agent_table, crowd: list[tuple]) -> None:
    agents = [{"id": i, "x": x, "y": y, "yaw": yaw, "speed": v} for i, (x, y, yaw, v, _) in enumerate(crowd)]
    table = agent_table(0, *agents)
    here = situation(plain_log(table), table, *[i for i, (*_, off) in enumerate(crowd) if off])
    futures = here.futures
    for conflict in here.conflicts():
        at = round(conflict.time_to_conflict / STEP_S) - 1
        mine = boxes_at(here, conflict.agent, futures.by_log)
        others = boxes_at(here, conflict.opponent, futures.expected)
        assert mine[at].distance(others[at]) < 1e-6
        assert all(a.intersection(b).area < 1e-3 for a, b in zip(mine[:at], others[:at], strict=True))


# thresholds


def test_a_lower_threshold_sees_a_conflict_sooner(look) -> None:
    near = {"id": 2, "x": 85.0, "speed": 10.0}
    times = [
        look(near, ego={"speed": 4.0}, sigma_scale=1.0, probability_threshold=p, probability_clear=0.01).conflicts()[0]
        for p in (0.1, 0.3, 0.5, 0.7)
    ]
    seconds = [c.time_to_conflict for c in times]
    assert seconds == sorted(seconds) and seconds[0] < seconds[-1]
    assert all(c.overlap_probability == pytest.approx(times[0].overlap_probability) for c in times)


def test_whoever_is_off_its_log_stays_in_conflict_down_to_the_lower_threshold(look) -> None:
    scene = look(
        {"id": 2, "x": 80.2, "speed": 10.0},
        ego={"speed": 5.2},
        sigma_scale=1.0,
        probability_threshold=0.4,
        probability_clear=0.1,
    )
    assert 0.1 < scene.probability(0.01).max() < 0.4
    assert scene.conflicts() == []
    assert scene.still().tolist() == [2]


@pytest.mark.parametrize("first", [2, 4])
def test_whoever_overlaps_one_in_the_log_as_well_stays_in_conflict_for_another(look, first: int) -> None:
    """Agent 3 drives into agent 2 or 4 in the log itself, and into the ego only now; whoever has the lowest id."""
    follower, leader = {"id": 3, "x": 82.0, "speed": 12.0}, {"id": first, "x": 92.0, "speed": 5.0}
    stands, gone = (look(follower, leader, ego={"x": x, "speed": 0.0}) for x in (100.0, 300.0))
    for scene, expected in ((stands, [3]), (gone, [])):
        off = np.isin(scene.table.id, [1, first])
        found = still_in_conflict(scene.detector, scene.uncovered, scene.table.id == 3, off)
        assert scene.table.id[found].tolist() == expected


@pytest.mark.parametrize(("speed", "expected"), [(4.0, []), (10.0, [2])])
def test_the_own_way_of_an_agent_off_its_log_leads_into_those_ahead_or_not(
    look, speed: float, expected: list[int]
) -> None:
    """Its log, at 10 m/s, leads into the ego in either case; agent 3, who drives into it from behind, follows it."""
    scene = look({"id": 2, "x": 85.0, "speed": 10.0}, {"id": 3, "x": 73.0, "speed": 12.0}, ego={"speed": 4.0})
    scene.table.speed[scene.table.row(2)] = speed
    scene = replace(scene, off=np.ones(3, np.bool_), forecast=straight_on(scene.table))
    futures, agents = scene.uncovered, scene.table.id == 2
    pairs = scene.detector.pairs(futures, agents, scene.off)
    assert scene.table.id[scene.detector.drive_into_conflict(futures, pairs)].tolist() == expected
    assert still_in_conflict(scene.detector, futures, agents, scene.off).any()


def test_the_lower_threshold_is_not_above_the_other() -> None:
    config = {"probability_clear": 0.5, "probability_threshold": 0.4}
    with pytest.raises(InputError, match=r"clear is 0.5, expected at most probability_threshold, which is 0.4"):
        ParameterOverrides("conflict", config)(ConflictConfig())


@settings(max_examples=40)
@given(crowd, st.floats(0.05, 0.6))
def test_the_broad_phase_loses_no_pair(agent_table, crowd: list[tuple], least: float) -> None:
    """Against the exact probability of every pair at every step."""
    agents = [{"id": i, "x": x, "y": y, "yaw": yaw, "speed": v} for i, (x, y, yaw, v, _) in enumerate(crowd)]
    table = agent_table(0, *agents)
    here = situation(plain_log(table), table, roi_m=1e3, sigma_scale=1.0)
    everybody = np.ones(len(table), np.bool_)
    futures = here.futures
    pairs, found = here.detector.pair_probabilities(futures, everybody, everybody, least)
    logged, forecast, exact = futures.by_log, futures.expected, np.zeros(found.shape)
    for k, t in np.ndindex(*found.shape):
        a, b = logged.states[pairs[k, 0], t], forecast.states[pairs[k, 1], t]
        sizes, gaussian = (LENGTH, WIDTH, LENGTH, WIDTH), tuple(b[XX:])
        exact[k, t] = overlap.overlap_probability(*(b - a)[[X, Y]], a[YAW], b[YAW], sizes, gaussian, 0.0, -np.inf)
    assert found == pytest.approx(np.where(exact >= least, exact, 0.0), abs=1e-9)


# Other manoeuvres, and what closes fast


def with_mode(forecast: Forecast, row: int, velocity: tuple[float, float], probability: float) -> Forecast:
    """`forecast`, in which the agent of `row` may also move at `velocity` [m/s] from where it is forecast to begin."""
    steps = forecast.mean.shape[1]
    begin = 2.0 * forecast.mean[row, 0] - forecast.mean[row, 1]
    mean = begin + DT * np.arange(1, steps + 1)[:, None] * np.array(velocity)
    yaw = np.full((1, steps), np.arctan2(velocity[1], velocity[0]), np.float32)
    shares = np.zeros((len(forecast.id), 2), np.float32)
    shares[:] = (1.0 - probability, probability)
    chance = np.array([probability], np.float32)
    return replace(
        forecast,
        maneuver_probability=shares,
        modes=Modes(np.array([row]), chance, mean[None], yaw, forecast.covariance[row : row + 1]),
    )


def test_a_turn_that_is_less_probable_is_weighed(look, lane_centres) -> None:
    """The ego goes on in its lane, or, by 0.35, to the side, where agent 2 drives beside it."""
    scene = look({"id": 2, "x": 100.0, "y": lane_centres[2], "speed": 10.0})
    row, aside = scene.table.row(1), 1.5 * np.sign(lane_centres[2] - lane_centres[1])
    forecast = with_mode(straight_on(scene.table), row, (10.0, aside), 0.35)
    turning = replace(scene, forecast=forecast)
    others = turning.futures.expected.alternatives
    assert others.row.tolist() == [row] and others.weight == pytest.approx([0.35])
    assert others.states[0, 9, :2] == pytest.approx([110.0, lane_centres[1] + aside])
    assert turning.probability(0.2).max() == pytest.approx(0.35)
    assert not scene.probability(0.2).any()
    futures = turning.uncovered
    futures.cover(np.ones(len(scene.table), np.bool_), scene.table.id == 2)
    assert not len(futures.expected.alternatives), "nobody asks for those of the ego"


@pytest.mark.parametrize(("closing_time", "urgent"), [(1.0, True), (0.0, False)])
def test_what_closes_fast_is_urgent_whatever_is_forecast(look, closing_time: float, urgent: bool) -> None:
    """The ego brakes hard right before agent 2, and is not forecast."""
    ego = {"speed": 10.0, "acceleration": -8.0}
    scene = look({"id": 2, "x": 91.5, "speed": 14.0}, ego=ego, closing_time=closing_time)
    scene = replace(scene, forecast=Forecast.empty(NOW))
    conflicts = scene.conflicts()
    assert [(conflict.agent, conflict.urgent) for conflict in conflicts] == ([(2, True)] if urgent else [])
    assert scene.still().tolist() == ([2] if urgent else [])
    if urgent:
        assert conflicts[0].time_to_conflict <= 1.0 and conflicts[0].overlap_probability == 1.0


@pytest.mark.parametrize(("braking", "found"), [(3.5, False), (5.0, True), (8.0, True)])
def test_whoever_brakes_in_an_emergency_is_seen_for_twice_as_long(look, placed, braking: float, found: bool) -> None:
    """Agent 3 brakes 5.5 m ahead of agent 2, at 14 m/s both, without a forecast, and they meet after 1.2 to 1.8 s."""
    scene = look({"id": 2, "x": 100.0, "speed": 14.0}, {"id": 3, "x": 100.0, "speed": 14.0}, ego={"x": 250.0})
    table = placed(scene.table, 3, x=110.0, speed=14.0, acceleration=-braking)
    scene = replace(scene, table=table, off=scene.off | (table.id == 3), forecast=Forecast.empty(NOW))
    conflicts = scene.conflicts()
    assert [(one.agent, one.opponent, one.urgent) for one in conflicts] == [(2, 3, True)] * found
    assert all(1.0 < one.time_to_conflict < 2.0 for one in conflicts)


# Which pairs are compared

seeds, radii = st.integers(0, 2**32), st.floats(0.0, 60.0)


@given(seeds, radii, st.floats(0.0, 5.0), st.integers(0, 15))
def test_pairs_are_those_in_the_region_of_each_other(seed: int, radius: float, time: float, agents: int) -> None:
    random = np.random.default_rng(seed)
    x, y = random.normal(0.0, 30.0, (2, agents))
    yaw, speed = random.uniform(-4.0, 4.0, agents), random.uniform(0.0, 15.0, agents)
    of, others = random.random((2, agents)) < 0.5
    scene = np.sort(random.integers(0, 3, agents))
    everyone = agent_arrays(agents, x=x, y=y, yaw=yaw, speed=speed, scene=scene)
    now, soon = np.array([x, y]), np.array([x, y]) + 1e-4 * speed * np.array([np.cos(yaw), np.sin(yaw)])
    apart, then = (np.hypot(*(p[:, :, None] - p[:, None])) for p in (now, soon))
    within = (apart <= radius) | (apart - time * np.maximum((apart - then) / 1e-4, 0.0) <= radius + 1e-3)
    sure = (apart <= radius) | (np.abs(apart - time * (apart - then) / 1e-4 - radius) > 0.1)  # not a matter of rounding
    mine = within & (scene[:, None] == scene)
    np.fill_diagonal(mine, val=False)
    asked = sure & of[:, None] & others
    found = np.zeros_like(mine)
    found[tuple(pairs_in_region(everyone, of, others, radius, time).T)] = True
    assert (found == mine)[asked].all() and not found[~(of[:, None] & others)].any()


@given(seeds)
def test_a_follower_has_the_other_ahead_in_its_strip_and_heads_the_same_way(seed: int) -> None:
    random = np.random.default_rng(seed)
    x, y = random.normal(0.0, [[12.0], [2.0]], (2, 8))
    yaw, length, width = (
        random.normal(0.0, random.choice([0.5, 3.0]), 8),
        random.uniform(3, 12, 8),
        random.uniform(1, 3, 8),
    )
    leader, follower = both = random.integers(0, 8, (2, 40))
    ahead, left = to_body(x[leader] - x[follower], y[leader] - y[follower], yaw[follower])
    expected = ahead > FOLLOWED * 0.5 * (length[leader] + length[follower])
    expected &= np.abs(left) < 0.5 * (width[leader] + width[follower])
    expected &= np.cos(yaw[leader] - yaw[follower]) > 0.0
    everyone = agent_arrays(len(x), x=x, y=y, yaw=yaw, length=length, width=width)
    assert followed(both.T.copy(), everyone).tolist() == expected.tolist()


@pytest.fixture
def crowd60(make_scenario, track) -> tuple[ConflictDetector, AgentTable]:
    """Sixty agents over 600 m of road, some of them faster than those ahead."""
    rng = np.random.default_rng(11)
    tracks = [
        track(i, x=10.0 * i, y=float(rng.choice([-5.49, -9.15])), speed=float(rng.uniform(5, 20))) for i in range(1, 61)
    ]
    log = make_scenario(*tracks).log
    return ConflictDetector(log, 30.0, ConflictConfig()), log.table(NOW)


def test_futures_are_made_only_in_the_region_and_once(crowd60) -> None:
    detector, table = crowd60
    futures, first, far = (
        Futures(detector.log, detector.config, table, straight_on(table)),
        table.id == 20,
        table.id == 50,
    )
    detector.conflicts(futures, ~first, first)
    covered, by_log = futures.covered.id.tolist(), futures.by_log
    dx, dy = table.x - table.x[first], table.y - table.y[first]
    distance = np.hypot(dx, dy)
    nearer = -dx * (table.speed - table.speed[first]) / np.maximum(distance, 1e-9)  # everybody heads along x
    soon = distance - detector.config.approach_time * np.maximum(nearer, 0.0)
    assert covered == table.id[soon <= 30.0].tolist() and (distance <= 30.0).sum() < len(covered) < len(table)
    still_in_conflict(detector, futures, first, first)
    assert futures.by_log is by_log, "what is made is not made again"
    detector.conflicts(futures, ~far, far)
    assert {*covered, 50} < set(futures.covered.id.tolist())
