"""Conflict detection: one golden scene per verdict, against shapely and against Monte Carlo."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from litsim_policy.conflict import Conflict, ConflictConfig, ConflictDetector, Futures, overlap_probability
from litsim_predictor.forecast import Forecast
from litsim_sim.geometry import box_corners, boxes_overlap
from litsim_sim.log import Log
from litsim_sim.scene import AgentTable

DT = 0.2  # [s] between instants of the forecasts here
NOW = 5  # step at which the scenes are looked at
LENGTH, WIDTH = 4.5, 2.0  # [m] of everybody


def straight_on(table: AgentTable, horizon: float = 5.0) -> Forecast:
    """Everybody goes on as it moves now."""
    t = DT * np.arange(1, round(horizon / DT) + 1)
    heading = np.stack([np.cos(table.yaw), np.sin(table.yaw)], axis=-1)
    gone = (table.speed[:, None] * t)[..., None] * heading[:, None, :]
    mean = np.stack([table.x, table.y], axis=-1)[:, None, :] + gone
    return Forecast(
        step=table.step,
        dt=DT,
        id=table.id,
        mean=mean,
        yaw=np.repeat(table.yaw[:, None], len(t), axis=1).astype(np.float32),
        covariance=np.full((len(table), len(t), 3), [1.0, 0.5, 0.0], np.float32),
        maneuver_probability=np.empty((len(table), 0), np.float32),
        valid=np.ones(len(table), np.bool_),
    )


@dataclass(frozen=True)
class Scene:
    """What one detection looks at; the agents of `off` are off their log."""

    detector: ConflictDetector
    table: AgentTable
    off: np.ndarray
    logged: Futures
    forecast: Futures

    def conflicts(self) -> list[Conflict]:
        return self.detector.detect(self.table, ~self.off, self.off, self.logged, self.forecast, DT)


def scene(log: Log, table: AgentTable, *off: int, roi_m: float = 30.0, **config: float) -> Scene:
    detector = ConflictDetector(log, roi_m, ConflictConfig(**config))
    logged, forecast = detector.logged_future(table, DT), detector.forecast_future(table, straight_on(table))
    return Scene(detector, table, np.isin(table.id, off), logged, forecast)


@pytest.fixture
def look(make_scenario, track, placed, lane_centres):
    """Looks at NOW at an ego, agent 1, that is elsewhere than in its log, among vehicles on their logs.

    The ego is at x = 100 in lane 1, at 10 m/s if not told otherwise.
    """

    def at_now(*others: dict[str, Any], ego: dict[str, float] | None = None, **config: float) -> Scene:
        tracks = []
        for fields in others:
            begin = dict(fields)
            speed, yaw = begin.get("speed", 10.0), begin.get("yaw", 0.0)
            begin["x"] = begin["x"] - 0.1 * NOW * speed * np.cos(yaw)
            begin["y"] = begin.get("y", lane_centres[1]) - 0.1 * NOW * speed * np.sin(yaw)
            tracks.append(track(**begin))
        log = make_scenario(track(1, x=300.0), *tracks).log
        where = {"x": 100.0, "y": lane_centres[1], "yaw": 0.0, "speed": 10.0} | (ego or {})
        return scene(log, placed(log.table(NOW), 1, **where), 1, **config)

    return at_now


def boxes_at(scene: Scene, agent: int, future: Futures) -> list[shapely.Polygon]:
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


def test_a_follower_as_slow_as_the_ego_is_in_none(look) -> None:
    assert look({"id": 2, "x": 85.0, "speed": 4.0}, ego={"speed": 4.0}).conflicts() == []


def test_a_leader_that_the_ego_runs_into_is_in_none(look) -> None:
    scene = look({"id": 2, "x": 112.0, "speed": 4.0}, ego={"speed": 12.0})
    pairs = scene.detector.near(scene.table, ~scene.off, scene.off)
    _, hit = scene.detector.first_overlap(scene.table, scene.logged, scene.forecast, pairs)
    assert hit.tolist() == [True], "they would touch, if nobody did anything"
    assert scene.conflicts() == []


def test_a_leader_that_cuts_in_right_before_the_ego_is_in_conflict(look, lane_centres) -> None:
    """It is not yet ahead in the strip that the ego sweeps: it can still stay where it is."""
    scene = look({"id": 2, "x": 103.0, "y": lane_centres[0], "speed": 8.0, "yaw": -0.15}, ego={"speed": 10.0})
    assert [c.agent for c in scene.conflicts()] == [2]


def test_a_crossing_at_an_angle_is_found_when_shapely_finds_it(look, lane_centres) -> None:
    scene = look({"id": 2, "x": 94.0, "y": lane_centres[3], "speed": 14.0, "yaw": 0.3, "last": 38})
    mine, others = boxes_at(scene, 2, scene.logged), boxes_at(scene, 1, scene.forecast)
    meet = [a.intersects(b) for a, b in zip(mine, others, strict=True)]
    (conflict,) = scene.conflicts()
    at = meet.index(True)
    assert conflict.time_to_conflict == pytest.approx((at + 1) * DT)
    assert at > 0 and conflict.pose[:2] == pytest.approx(shapely.get_coordinates(mine[at].centroid)[0])
    assert conflict.pose[2] == pytest.approx(0.3)


def test_driving_alongside_in_the_next_lane_is_none(look, lane_centres) -> None:
    beside = ({"id": 2, "x": 85.0, "y": lane_centres[0]}, {"id": 3, "x": 85.0, "y": lane_centres[2]})
    assert look(*beside, ego={"speed": 4.0}).conflicts() == []


def test_crossing_where_the_ego_has_been_before_is_none(look, lane_centres) -> None:
    crossing = {"id": 2, "x": 86.0, "y": lane_centres[3], "speed": 14.0, "yaw": 0.3, "last": 38}
    scene = look(crossing, ego={"speed": 14.0})
    swept = [shapely.unary_union(boxes_at(scene, *of)) for of in ((2, scene.logged), (1, scene.forecast))]
    assert swept[0].intersects(swept[1]), "in space, they overlap"
    assert scene.conflicts() == []


def test_agents_outside_of_the_region_of_interest_are_not_looked_at(look) -> None:
    fast = {"id": 2, "x": 65.0, "speed": 25.0}
    assert look(fast, ego={"speed": 4.0}, roi_m=34.9).conflicts() == []
    assert [c.agent for c in look(fast, ego={"speed": 4.0}, roi_m=35.1).conflicts()] == [2]


def test_conflicts_beyond_the_horizon_are_not_believed(look) -> None:
    late = {"id": 2, "x": 76.0, "speed": 10.0}  # contact after 3.25 s
    assert look(late, ego={"speed": 4.0}, horizon=3.0).conflicts() == []
    (conflict,) = look(late, ego={"speed": 4.0}, horizon=3.5).conflicts()
    assert conflict.time_to_conflict == pytest.approx(3.4)


def test_a_margin_lengthens_the_boxes(look) -> None:
    near = {"id": 2, "x": 95.0, "speed": 10.0}  # half a metre behind, and no faster
    assert look(near).conflicts() == []
    assert [c.agent for c in look(near, margin=0.6).conflicts()] == [2]


def test_a_log_that_is_over_by_then_is_in_none(look) -> None:
    leaves = {"id": 2, "x": 85.0, "speed": 10.0, "last": NOW + 15}
    assert look(leaves, ego={"speed": 4.0}).conflicts() == []
    stays = {"id": 2, "x": 85.0, "speed": 10.0, "last": NOW + 18}
    assert len(look(stays, ego={"speed": 4.0}).conflicts()) == 1


def test_an_ego_without_a_forecast_is_in_none(look) -> None:
    found = look({"id": 2, "x": 85.0, "speed": 10.0}, ego={"speed": 4.0})
    unknown = straight_on(found.table)
    unknown.valid[found.table.row(1)] = False
    nowhere = found.detector.forecast_future(found.table, unknown)
    assert len(found.conflicts()) == 1 and replace(found, forecast=nowhere).conflicts() == []


def test_an_empty_forecast_is_no_conflict(look) -> None:
    found = look({"id": 2, "x": 85.0, "speed": 10.0}, ego={"speed": 4.0})
    nobody = straight_on(AgentTable.empty(NOW))
    assert not found.detector.forecast_future(found.table, nobody).valid.any()


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


def test_of_two_opponents_the_one_that_is_met_first_is_named(look) -> None:
    scene = look({"id": 2, "x": 82.0, "speed": 12.0}, {"id": 3, "x": 92.0, "speed": 5.0}, ego={"speed": 0.0})
    (conflict,) = replace(scene, off=np.isin(scene.table.id, [1, 3])).conflicts()
    assert (conflict.agent, conflict.opponent) == (2, 3)


def test_background_meets_background_that_is_off_its_log(look, lane_centres) -> None:
    scene = look({"id": 2, "x": 60.0, "y": lane_centres[3], "speed": 10.0}, {"id": 3, "x": 75.0, "y": lane_centres[3]})
    assert scene.conflicts() == [], "both on their logs: theirs to sort out"
    stopped = scene.table.speed.copy()
    stopped[scene.table.row(3)] = 2.0
    table = replace(scene.table, speed=stopped)
    forecast = scene.detector.forecast_future(table, straight_on(table))
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
@given(crowd, st.randoms(use_true_random=False))
def test_conflicts_do_not_depend_on_the_order_of_the_agents(agent_table, crowd: list[tuple], random) -> None:
    """Other ids, and so other rows: the same agents at the same times and places."""

    def found(names: list[int]) -> set[tuple]:
        agents = [
            {"id": name, "x": x, "y": y, "yaw": yaw, "speed": speed}
            for name, (x, y, yaw, speed, _) in zip(names, crowd, strict=True)
        ]
        table = agent_table(0, *agents)
        off = [name for name, (*_, is_off) in zip(names, crowd, strict=True) if is_off]
        original = {name: i for i, name in enumerate(names)}
        conflicts = scene(plain_log(table), table, *off).conflicts()
        return {(original[c.agent], c.time_to_conflict, tuple(c.pose)) for c in conflicts}

    names = list(range(1, len(crowd) + 1))
    shuffled = names.copy()
    random.shuffle(shuffled)
    assert found(names) == found(shuffled)


@settings(max_examples=60)
@given(crowd)
def test_every_conflict_is_an_overlap_that_shapely_sees_and_none_comes_earlier(agent_table, crowd: list[tuple]) -> None:
    agents = [{"id": i, "x": x, "y": y, "yaw": yaw, "speed": v} for i, (x, y, yaw, v, _) in enumerate(crowd)]
    table = agent_table(0, *agents)
    here = scene(plain_log(table), table, *[i for i, (*_, off) in enumerate(crowd) if off])
    for conflict in here.conflicts():
        at = round(conflict.time_to_conflict / DT) - 1
        mine = boxes_at(here, conflict.agent, here.logged)
        others = boxes_at(here, conflict.opponent, here.forecast)
        assert mine[at].distance(others[at]) < 1e-6
        assert all(a.intersection(b).area < 1e-3 for a, b in zip(mine[:at], others[:at], strict=True))


# futures


def test_an_agent_that_rejoins_its_log_keeps_its_residual_in_the_future(make_scenario, track, placed) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=80.0)).log
    detector = ConflictDetector(log, 30.0, ConflictConfig())
    logged = detector.logged_future(log.table(NOW), DT)
    shifted = detector.logged_future(placed(log.table(NOW), 2, x=log.x[1, NOW] - 3.0, y=log.y[1, NOW] + 0.5), DT)
    assert shifted.x[1] == pytest.approx(logged.x[1] - 3.0) and shifted.y[1] == pytest.approx(logged.y[1] + 0.5)
    held = placed(log.table(NOW), 2, x=log.x[1, NOW] - 3.0, controller=1)
    assert detector.logged_future(held, DT).x[1] == pytest.approx(logged.x[1]), "put back at once"


def test_futures_lie_at_multiples_of_dt_up_to_the_horizon(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0, last=20), track(2, x=80.0, last=40)).log
    future = ConflictDetector(log, 30.0, ConflictConfig(horizon=3.0)).logged_future(log.table(NOW), DT)
    assert future.x.shape == (2, 15)
    assert future.x[1, :3] == pytest.approx([87.0, 89.0, 91.0])
    assert future.valid[0].sum() == 7, "the ego's log ends at step 20, 1.5 s from now"


# overlap_probability


def monte_carlo(delta: np.ndarray, yaws: tuple[float, float], sizes: tuple, covariance: np.ndarray) -> float:
    sigma_x, sigma_y, rho = covariance
    both = np.array([[sigma_x**2, rho * sigma_x * sigma_y], [rho * sigma_x * sigma_y, sigma_y**2]])
    drawn = np.random.default_rng(0).multivariate_normal(delta, both, 40_000)
    turned = (np.full(len(drawn), yaw) for yaw in yaws)
    return float(boxes_overlap(drawn[:, 0], drawn[:, 1], *turned, *sizes).mean())


@pytest.mark.parametrize("delta", [(0.0, 0.0), (4.0, 0.0), (6.0, 1.0), (0.0, 2.2), (9.0, 3.0)])
@pytest.mark.parametrize("covariance", [(0.5, 0.2, 0.0), (2.0, 0.8, 0.6), (3.0, 1.5, -0.7)])
@pytest.mark.parametrize("yaws", [(0.0, 0.0), (0.3, -0.4)])
def test_overlap_probability_is_that_of_monte_carlo(delta: tuple, covariance: tuple, yaws: tuple) -> None:
    sizes = (np.array([4.5, 2.0]), np.array([6.0, 2.2]))
    got = overlap_probability(np.array(delta), yaws, sizes, np.array(covariance))
    assert got == pytest.approx(monte_carlo(np.array(delta), yaws, sizes, np.array(covariance)), abs=0.08)


def test_overlap_is_certain_within_and_impossible_far_apart() -> None:
    sizes = (np.array([4.5, 2.0]), np.array([4.5, 2.0]))
    sharp = np.array([0.1, 0.1, 0.0])
    assert overlap_probability(np.zeros(2), (0.0, 0.0), sizes, sharp) == 1.0
    assert overlap_probability(np.array([20.0, 0.0]), (0.0, 0.0), sizes, sharp) == 0.0
