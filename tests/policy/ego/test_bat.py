"""The ego that tracks its own forecast, with forecasts made by hand."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.ego.bat import (
    BatConfig,
    BatEgo,
    SampledManeuvers,
    fitted_acceleration,
    lanes_ahead,
    onward,
    travelled,
    within_edges,
)
from litsim_predictor.forecast import Forecast
from litsim_predictor.inference.predictor import LearnedPredictor
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import box_corners
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.scene import STEP_S, AgentTable, Controller
from litsim_sim.scenario.scenario import Scenario

DT, STEPS = 0.2, 25
TIMES = DT * np.arange(1, STEPS + 1)
KINEMATIC = BatConfig(predictor="kinematic")

Future = Callable[[AgentTable, int], np.ndarray]
"""Positions (STEPS, 2) of the ego, which is in the given row of the table."""


@dataclass
class Oracle:
    """A predictor that says of the ego what the test does; `valid` is whether it may be believed."""

    ego_id: int
    future: Future
    valid: bool = True

    def forecast(self, table: AgentTable) -> Forecast:
        row = table.row(self.ego_id)
        if row < 0:
            return forecast_of(table.step, np.empty(0, np.int64), np.empty((0, STEPS, 2)), self.valid)
        return forecast_of(table.step, np.array([self.ego_id]), self.future(table, row)[None], self.valid)


def forecast_of(step: int, ids: np.ndarray, mean: np.ndarray, valid: bool) -> Forecast:
    way = np.diff(mean, axis=1)
    yaw = np.arctan2(way[..., 1], way[..., 0])
    return Forecast(
        step=step,
        dt=DT,
        id=ids,
        mean=mean,
        yaw=np.concatenate([yaw[:, :1], yaw], axis=1).astype(np.float32),
        covariance=np.ones((len(ids), STEPS, 3), np.float32),
        maneuver_probability=np.empty((len(ids), 0), np.float32),
        valid=np.full(len(ids), valid),
    )


def ego_with(scenario: Scenario, future: Future, valid: bool = True) -> BatEgo:
    ego = BatEgo(scenario, KINEMATIC)
    ego._predictor = Oracle(scenario.ego_id, future, valid)
    return ego


def driven(drive, scenario: Scenario, ego: BatEgo):
    """The loop around `ego`; the background follows its log."""

    def answer(table: AgentTable, row: int) -> tuple[float, float]:
        command = ego.plan(table)
        return command.acceleration, command.yaw_rate

    return drive(scenario, answer, policy="replay")


def straight(table: AgentTable, row: int, acceleration: float = 0.0, aside: float = 0.0) -> np.ndarray:
    """Along +x from where the ego is, with a change of speed [m/s2] and of place within 5 s [m]."""
    way = table.speed[row] * TIMES + 0.5 * acceleration * TIMES**2
    return np.column_stack([table.x[row] + way, table.y[row] + aside * TIMES / TIMES[-1]])


# Parts


@given(st.floats(0, 30), st.floats(-3, 3))
def test_the_acceleration_of_a_forecast_is_found_again(speed: float, acceleration: float) -> None:
    way = speed * TIMES + 0.5 * acceleration * TIMES**2
    assert fitted_acceleration(way, DT, speed, 2.0) == pytest.approx(acceleration, abs=1e-9)


def test_only_the_preview_counts_and_without_a_forecast_the_speed_is_kept() -> None:
    way = 10.0 * TIMES
    way[10:] += 50.0
    assert fitted_acceleration(way, DT, 10.0, 2.0) == pytest.approx(0.0)
    assert fitted_acceleration(way, DT, 10.0, 2.2) > 1.0
    assert fitted_acceleration(np.empty(0), DT, 10.0, 2.0) == 0.0


def test_steps_that_lead_back_are_none() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.0], [1.5, 0.0], [1.5, 1.0]])
    assert onward(points, 0.0).tolist() == [[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0]]
    assert travelled(onward(points, 0.0)).tolist() == [1.0, 1.0, 2.0, 3.0]
    assert travelled(onward(points, np.pi)).tolist() == [0.0, 0.5, 0.5, 1.5]


def test_points_are_pulled_inside_the_outermost_lanes_only(make_scenario, track, lane_centres) -> None:
    lane_map = make_scenario(track(1, x=100.0)).lane_map
    leftmost, rightmost = lane_centres[0], lane_centres[-1]
    y = np.array([leftmost + 5.0, leftmost + 0.9, leftmost + 0.2, leftmost - 1.7, rightmost - 0.8, rightmost - 3.0])
    points = np.column_stack([np.full(6, 100.0), y])
    inside = within_edges(lane_map, points, np.zeros(6), 1.2)
    room = 0.5 * 3.66 - 1.2
    assert inside[:, 0] == pytest.approx(100.0, abs=0.05)
    expected = [leftmost + room, leftmost + room, y[2], y[3], rightmost - room, rightmost - room]
    assert inside[:, 1] == pytest.approx(expected, abs=0.05)
    assert within_edges(lane_map, points, np.zeros(6), 9.0)[:2, 1] == pytest.approx(leftmost, abs=0.05)


def test_a_ramp_beyond_a_gore_is_no_road_ahead(make_scenario, track) -> None:
    lane_map = make_scenario(track(1, x=100.0)).lane_map

    def ahead(name: str) -> set[str]:
        return {lane_map.lanes[row].id for row in lanes_ahead(lane_map, lane_map.row(name))}

    assert "on_ramp_0" not in ahead("upstream_3") and {"weave_0", "off_ramp_0"} <= ahead("upstream_3")
    assert ahead("downstream_0") == {f"downstream_{index}" for index in range(5)}
    assert "upstream_0" not in ahead("on_ramp_0") and "downstream_4" in ahead("on_ramp_0")


# Driving


def test_its_predictor_is_checked() -> None:
    problem = "predictor is 'crystal ball', expected one of bat, cs_lstm, default, kinematic, "
    with pytest.raises(InputError, match=f"ego: parameter {problem}"):
        ParameterOverrides("ego", {"predictor": "crystal ball"})(BatConfig())


def test_during_the_history_and_off_the_road_it_says_nothing(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0, last=30), track(2, x=60.0), history_steps=10)
    ego = ego_with(scenario, lambda table, row: straight(table, row, 1.0))
    for step in (0, 9, 31, 40):
        command = ego.plan(scenario.log.table(step))
        assert (command.step, command.acceleration, command.yaw_rate) == (step, 0.0, 0.0)
    assert ego.plan(scenario.log.table(10)).acceleration == pytest.approx(1.0)


@pytest.mark.parametrize(("acceleration", "yaw"), [(-0.9, 0.0), (0.6, -0.06)])
def test_with_a_perfect_forecast_it_drives_its_log(
    make_scenario, track, drive, acceleration: float, yaw: float
) -> None:
    own = track(1, x=60.0, speed=12.0, acceleration=acceleration, yaw=yaw, last=100)
    scenario = make_scenario(own)
    log = scenario.log

    def future(table: AgentTable, row: int) -> np.ndarray:
        gone = TIMES + (table.step - own.first) * STEP_S
        way = own.speed * gone + 0.5 * own.acceleration * gone**2
        return np.column_stack([own.x + way * np.cos(yaw), own.y + way * np.sin(yaw)])

    run = driven(drive, scenario, ego_with(scenario, future))
    assert max(run.from_log(1, step) for step in range(101)) < 0.2
    assert log.steps == 101


def test_it_deviates_from_its_log_where_the_forecast_does(make_scenario, track, drive, lane_centres) -> None:
    """The log goes straight on; the forecast leads to the next lane within 5 s."""
    scenario = make_scenario(track(1, x=60.0, y=lane_centres[2], last=150))

    def future(table: AgentTable, row: int) -> np.ndarray:
        return straight(table, row, aside=lane_centres[1] - table.y[row])

    run = driven(drive, scenario, ego_with(scenario, future))
    assert abs(run.series(1, "y")[-1] - lane_centres[1]) < 0.5
    assert run.from_log(1, 150) > 2.5


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_forecast_off_the_road_does_not_lead_it_there(make_scenario, track, drive, lane_centres, side: float) -> None:
    lane = lane_centres[0] if side > 0 else lane_centres[-1]
    scenario = make_scenario(track(1, x=60.0, y=lane, last=200))
    run = driven(drive, scenario, ego_with(scenario, lambda table, row: straight(table, row, aside=8.0 * side)))
    x, y, yaw = (run.series(1, name) for name in ("x", "y", "yaw"))
    corners = box_corners(x, y, yaw, np.full(len(x), 4.5), np.full(len(x), 2.0)).reshape(-1, 2)
    assert scenario.lane_map.inside_road(corners[:, 0], corners[:, 1]).all()
    assert side * (y[-1] - lane) > 0.4, "but to the edge it goes"


def test_it_stops_and_never_reverses(make_scenario, track, drive) -> None:
    scenario = make_scenario(track(1, x=60.0, speed=8.0, last=150))

    def future(table: AgentTable, row: int) -> np.ndarray:
        return np.column_stack([np.maximum(table.x[row] - 2.0 * TIMES, 0.0), np.full(STEPS, table.y[row])])

    run = driven(drive, scenario, ego_with(scenario, future))
    assert run.series(1, "speed")[-1] == pytest.approx(0.0, abs=1e-6)
    assert np.diff(run.series(1, "x")).min() >= 0.0


def test_it_sees_as_far_as_its_parameter_says(make_scenario, track) -> None:
    """BAT has learned from those up to 62 m away: one who stands 45 m ahead matters, unless it is not shown."""
    me, other = track(1, x=20.0, speed=12.0, last=60), track(2, x=101.0, speed=0.0, last=60)
    alone, behind = make_scenario(me, history_steps=31), make_scenario(me, other, history_steps=31)

    def commands(scenario: Scenario, config: BatConfig) -> list[tuple[float, float]]:
        ego = BatEgo(scenario, config)
        answers = [ego.plan(scenario.log.table(step)) for step in range(32)]
        return [(answer.acceleration, answer.yaw_rate) for answer in answers]

    near = BatConfig(roi_m=30.0)
    assert commands(behind, near) == commands(alone, near) == commands(alone, BatConfig())
    assert commands(behind, BatConfig())[-1] != commands(behind, near)[-1]


def test_without_a_forecast_it_keeps_its_lane_and_speed(make_scenario, track, drive, lane_centres) -> None:
    scenario = make_scenario(track(1, x=60.0, y=lane_centres[2] + 0.8, yaw=0.03, last=150))
    ego = ego_with(scenario, lambda table, row: straight(table, row, -2.0), valid=False)
    run = driven(drive, scenario, ego)
    assert run.series(1, "speed") == pytest.approx(10.0, abs=1e-6)
    offset = run.series(1, "y") - lane_centres[2]
    assert offset.max() < 1.1 and abs(offset[-1]) < 0.75, "the path comes onto the centre line slowly"


@pytest.fixture(scope="module")
def wild(make_scenario, track) -> BatEgo:
    """Its forecast is what `wild.offset` (STEPS, 2) adds to going straight on."""
    ego = ego_with(make_scenario(track(1, x=100.0)), lambda table, row: straight(table, row) + ego.offset)
    return ego


@given(seed=st.integers(0, 10_000), spread=st.sampled_from([0.5, 5.0, 100.0]), speed=st.floats(0, 30))
def test_whatever_is_forecast_commands_are_within_the_limits(
    wild: BatEgo, agent_table, seed: int, spread: float, speed: float
) -> None:
    wild.offset = np.random.default_rng(seed).normal(0.0, spread, (STEPS, 2))
    table = agent_table(10, {"id": 1, "x": 300.0, "y": -5.0, "speed": speed, "controller": Controller.EGO})
    command, limits = wild.plan(table), wild._scenario.vehicle
    assert -limits.deceleration_max <= command.acceleration <= limits.acceleration_max
    assert speed + STEP_S * command.acceleration >= -1e-9
    assert abs(command.yaw_rate) <= speed * limits.curvature_max + 1e-9
    assert abs(command.yaw_rate) * speed <= limits.lateral_acceleration_max + 1e-9


def test_a_run_with_the_kinematic_predictor_is_smooth_and_the_same_twice(
    make_scenario, track, drive, beyond_limits, lane_centres
) -> None:
    scenario = make_scenario(
        track(1, x=60.0, y=lane_centres[1], yaw=-0.02, last=150), track(2, x=90.0, speed=8.0, last=150)
    )
    one, two = (driven(drive, scenario, BatEgo(scenario, KINEMATIC)) for _ in range(2))
    for field in ("x", "y", "yaw", "speed"):
        assert np.array_equal(one.series(1, field), two.series(1, field))
    assert beyond_limits(one.results, (Controller.EGO,)) == []
    assert np.abs(one.series(1, "yaw_rate")).max() < 0.1


# Sampled manoeuvres

SHARES = np.array([0.5, 0.3, 0.2], np.float32)


class Chancy(LearnedPredictor):
    """Knows three manoeuvres, and notes which it is asked for."""

    decodes_maneuvers = True

    def __init__(self, ego_id: int) -> None:
        self.ego_id, self.asked = ego_id, []

    def forecast(self, table: AgentTable, maneuver: int | None = None) -> Forecast:
        self.asked.append(maneuver)
        ahead = straight(table, table.row(self.ego_id))[None]
        return replace(
            forecast_of(table.step, np.array([self.ego_id]), ahead, valid=True), maneuver_probability=SHARES[None]
        )


def maneuvers_asked_for(scenario: Scenario, steps: int) -> list[int | None]:
    chancy = Chancy(scenario.ego_id)
    sampled = SampledManeuvers(chancy, scenario, "chancy")
    for step in range(steps):
        sampled.forecast(scenario.log.table(step))
    return chancy.asked


def test_a_sampled_manoeuvre_is_kept_for_five_seconds(make_scenario, track) -> None:
    asked = maneuvers_asked_for(make_scenario(track(1, x=0.0, last=120), history_steps=10, seed=3), 120)
    assert asked[:10] == [None] * 10 and None not in asked[10:]
    assert all(len(set(asked[begin : begin + 50])) == 1 for begin in (10, 60))


def test_manoeuvres_are_sampled_by_their_probabilities_and_the_seed(make_scenario, track) -> None:
    log = make_scenario(track(1, x=0.0, last=9)).log

    def first(seed: int) -> int:
        scenario = SimpleNamespace(log=log, ego_id=1, history_steps=2, seed=seed)
        return maneuvers_asked_for(scenario, 3)[-1]

    drawn = [first(seed) for seed in range(400)]
    assert drawn[7] == first(7)
    assert np.abs(np.bincount(drawn, minlength=3) / 400 - SHARES).max() < 0.08  # three standard deviations


def test_sampled_manoeuvres_lead_the_ego_elsewhere() -> None:
    """With the packaged model: by the seed, as the most probable manoeuvre leads, or not."""

    def accelerations(seed: int, maneuver: Literal["most_probable", "sampled"]) -> list[float]:
        scenario = Scenario.load("demo", seed=seed)
        ego = BatEgo(scenario, BatConfig(maneuver=maneuver))
        return [ego.plan(scenario.log.table(step)).acceleration for step in range(scenario.history_steps + 2)]

    usual = accelerations(0, "most_probable")
    assert accelerations(1, "most_probable") == usual
    sampled = {seed: accelerations(seed, "sampled") for seed in (5, 8)}
    assert accelerations(5, "sampled") == sampled[5]
    assert usual in sampled.values() and any(drawn != usual for drawn in sampled.values())


def test_sampling_needs_a_model_that_can_be_asked_for_manoeuvres() -> None:
    for predictor in ("default", "kinematic"):
        with pytest.raises(InputError, match=f"maneuver is sampled, which predictor {predictor} does not support"):
            BatEgo(Scenario.load("demo"), BatConfig(predictor=predictor, maneuver="sampled"))
