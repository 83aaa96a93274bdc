"""Forecasts along lanes that bend, on the packaged street, where turns are sharp."""

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
import pytest
import shapely
import torch

from litsim_predictor.forecast import Forecast, Scope, Wanted
from litsim_predictor.inference.contract import DT, HISTORY, HORIZON, STRIDE, AgentFutures, FurtherFutures
from litsim_predictor.inference.lane_frames import FRAMES, LaneFrameFinder, LaneFrames, bend, from_lane_frames, unbend
from litsim_predictor.inference.predictor import LearnedPredictor
from litsim_predictor.inference.raster import raster_of_net
from litsim_predictor.models import network
from litsim_research.predictors.data.scenes import scene_batches
from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.models.along_lanes import AlongLanes
from litsim_research.predictors.models.weights import load_model
from litsim_sim.core.scene import AgentTable, FloatArray
from litsim_sim.lane_map.lane_map import LaneMap, LanePosition
from litsim_sim.scenario.scenario import packaged

Build = Callable[..., AgentTable]
STREET = packaged("nets/urban_like.net.xml")
LEFT_TURN, RIGHT_TURN, THROUGH = ":A_3_0", ":A_0_0", ":A_11_0"


@cache
def street() -> LaneMap:
    return raster_of_net(STREET)[0]


def path(lane: str, length: float = 120.0) -> FloatArray:
    """Poses (k, 3) at every metre from 20 m before the lane within a junction on."""
    before = next(row for row, each in enumerate(street().lanes) if lane in each.successors)
    begin = street().lanes[before].length - 20.0
    route = {street().lanes[street().row(name)].edge_id for name in street().lanes[street().row(lane)].successors}
    points = street().path_from(before, begin, length, route)
    line = shapely.LineString(points)
    along = np.array([line.interpolate(s).coords[0] for s in np.arange(0.0, length)])
    steps = np.diff(along, axis=0)
    return np.column_stack([along[:-1], np.arctan2(steps[:, 1], steps[:, 0])])


def driven(predictor: LearnedPredictor, build: Build, lane: str, at: int, speed: float = 5.0) -> Forecast:
    """The forecast of one who has driven along `lane` to the `at`-th pose of its path."""
    poses = path(lane)
    way = np.arange(len(poses), dtype=np.float64)
    for step in range(31):
        s = at + 0.1 * (step - 30) * speed
        x, y, yaw = (np.interp(max(s, 0.0), way, np.unwrap(column)) for column in poses.T)
        out = predictor.forecast(build(step, {"id": 1, "x": x, "y": y, "yaw": yaw, "speed": speed}))
    return out


def off(forecast: Forecast, lane: str) -> float:
    """How far the forecast leads away from the middle of the lane and of the road that follows, at most [m]."""
    line = shapely.LineString(path(lane)[:, :2])
    return float(max(line.distance(shapely.Point(*point)) for point in forecast.mean[0]))


def predictor(*, along_lanes: bool = True) -> LearnedPredictor:
    scope = Scope(30.0, Wanted.ALL, 3, along_lanes)
    return LearnedPredictor(network("default"), 1, scope, *raster_of_net(STREET))


@pytest.mark.parametrize("lane", [LEFT_TURN, RIGHT_TURN])
def test_who_turns_is_forecast_along_the_turn(agent_table: Build, lane: str) -> None:
    turning = driven(predictor(), agent_table, lane, 24)
    assert off(turning, lane) < 1.5
    assert off(driven(predictor(along_lanes=False), agent_table, lane, 24), lane) > 6.0
    assert np.cos(turning.yaw[0, -1] - path(lane)[60, 2]) > 0.95  # boxes turn with it


def test_who_is_too_fast_for_the_turn_goes_straight_on(agent_table: Build) -> None:
    fast = driven(predictor(), agent_table, LEFT_TURN, 22, speed=16.0)
    straight = driven(predictor(along_lanes=False), agent_table, LEFT_TURN, 22, speed=16.0)
    assert np.hypot(*(fast.mean - straight.mean)[0, :10].T).max() < 1.5
    assert off(fast, LEFT_TURN) > 6.0


def test_who_is_on_no_lane_has_no_way(agent_table: Build) -> None:
    x, y, yaw = path(LEFT_TURN)[24]
    across = {"id": 1, "x": x, "y": y, "yaw": yaw + 1.0, "speed": 5.0}
    one, other = (predictor(along_lanes=along).forecast(agent_table(0, across)) for along in (True, False))
    assert np.array_equal(one.mean, other.mean)


@pytest.mark.parametrize("name", ["us101", "us101_like", "i80"])
def test_the_roads_that_networks_are_trained_on_do_not_bend(name: str) -> None:
    lane_map = raster_of_net(packaged(f"nets/{name}.net.xml"))[0]
    lanes = np.arange(len(lane_map.lanes))
    start = np.zeros(len(lanes))
    at = LanePosition(lanes, start, start, lane_map.pose_at(lanes, start)[2])
    assert not len(LaneFrameFinder(lane_map).ahead(at, np.ones(len(lanes), np.bool_), start))


def test_ways_begin_at_the_agent_and_keep_beside_the_lane() -> None:
    lane = np.array([street().row(LEFT_TURN)])
    at = LanePosition(lane, np.array([3.0]), np.array([0.8]), street().pose_at(lane, np.array([3.0]))[2])
    lane_frames = LaneFrameFinder(street()).ahead(at, np.array([True]), np.array([4.0]))
    assert lane_frames.pose[0, 0] == pytest.approx(np.zeros(3), abs=1e-9)
    x, y, heading = (float(value[0]) for value in street().pose_at(lane, at.s))
    cos, sin = np.cos(heading), np.sin(heading)
    origin = np.array([x - 0.8 * sin, y + 0.8 * cos])
    points = origin + lane_frames.pose[0, :, :2] @ np.array([[cos, sin], [-sin, cos]])
    centre = shapely.LineString(street().path_from(int(lane[0]), 3.0, 200.0))
    assert [centre.distance(shapely.Point(*point)) for point in points] == pytest.approx(np.full(FRAMES, 0.8), abs=0.15)


def quarter_turn(radius: float = 10.0) -> LaneFrames:
    """A way of one agent that turns left by a right angle and then goes straight on."""
    s = np.minimum(np.arange(FRAMES, dtype=np.float64), np.pi / 2 * radius)
    on = np.arange(FRAMES) - s
    heading = s / radius
    pose = np.column_stack([radius * np.sin(heading), radius * (1.0 - np.cos(heading)) + on, heading])
    return LaneFrames(np.array([1]), pose[None])


def gaussians(rows: int) -> Iterator[np.ndarray]:
    yield np.stack([np.linspace(1.0, 40.0, HORIZON), np.full(HORIZON, 0.5)], axis=-1)[None].repeat(rows, axis=0)
    yield np.tile([3.0, 1.0], (rows, HORIZON, 1))
    yield np.full((rows, HORIZON), 0.2)


def test_paths_are_unbent_as_forecasts_are_bent() -> None:
    """So that networks learn futures along the lane, along which their forecasts are bent in runs."""
    mean, scale, correlation = (array.astype(np.float32) for array in gaussians(1))
    pose = quarter_turn().pose
    bent, _, _ = bend(pose, mean, scale, correlation)
    assert np.hypot(*(unbend(pose, bent.astype(np.float64)) - mean)[0].T).max() < 0.1
    assert np.hypot(*(unbend(pose, mean.astype(np.float64)) - mean)[0].T).max() > 5.0


def test_gaussians_turn_with_the_way() -> None:
    mean, scale, correlation = (array.astype(np.float32) for array in gaussians(1))
    bent = bend(quarter_turn().pose, mean, scale, correlation)
    # Behind the turn, ahead is to the left of the agent, and left is behind it.
    x, y = bent[0][0, -1]
    assert (x, y) == pytest.approx((10.0 - 0.5, 10.0 + 40.0 - np.pi / 2 * 10.0), abs=0.1)
    assert bent[1][0, -1] == pytest.approx([1.0, 3.0], abs=1e-4)
    assert bent[2][0, -1] == pytest.approx(-0.2, abs=1e-4)
    assert bent[0][0, 0] == pytest.approx(mean[0, 0], abs=0.1)


def test_what_is_not_a_number_stays_so_along_a_way() -> None:
    """Such a forecast is then marked as invalid."""
    pose = np.zeros((1, FRAMES, 3))
    nothing, some = np.full((1, HORIZON, 2), np.nan, np.float32), np.ones((1, HORIZON, 2), np.float32)
    mean, _, _ = bend(pose, nothing, some, np.zeros((1, HORIZON), np.float32))
    assert np.isnan(mean).all()


def test_only_agents_with_a_way_are_bent_with_all_they_may_do() -> None:
    mean, scale, correlation = (array.astype(np.float32) for array in gaussians(3))
    further = FurtherFutures(np.array([0, 1, 1]), np.array([3, 3, 6]), mean, scale, correlation)
    futures = AgentFutures(np.full((3, 9), 1 / 9, np.float32), mean, scale, correlation, further)
    bent = from_lane_frames(futures, quarter_turn())
    assert np.array_equal(bent.mean[[0, 2]], mean[[0, 2]])
    assert np.array_equal(bent.further.mean[0], mean[0])
    assert np.array_equal(bent.further.mean[1], bent.mean[1]) and np.array_equal(bent.further.mean[2], bent.mean[1])
    assert np.hypot(*(bent.mean[1, -1] - mean[1, -1])) > 20.0


def test_evaluation_forecasts_along_lanes_as_runs_do(agent_table: Build) -> None:
    """A vehicle that turns, evaluated by torch and forecast in a run, is at the same places."""
    import pandas as pd

    poses, speed = path(LEFT_TURN), 5.0
    frames = STRIDE * (HISTORY - 1 + HORIZON) + 1
    s = 9.0 + 0.1 * speed * np.arange(frames)
    x, y, yaw = (np.interp(s, np.arange(len(poses)), np.unwrap(column)) for column in poses.T)
    table = pd.DataFrame({"vehicle_id": 1, "frame": np.arange(frames), "x": x, "y": y, "yaw": yaw, "speed": speed})
    tracks = Tracks.from_table("turn", table.assign(length=4.5, width=2.0), STREET)
    (batch,) = scene_batches([tracks])
    model = AlongLanes(load_model("default")[0]).eval()
    with torch.inference_mode():
        mean = model(batch, decode="best").mean[0, 0, 0].numpy()
    running = predictor()
    for step in range(STRIDE * (HISTORY - 1) + 1):
        agent = {"id": 1, "x": x[step], "y": y[step], "yaw": yaw[step], "speed": speed, "length": 4.5, "width": 2.0}
        out = running.forecast(agent_table(step, agent))
    heading = float(batch.heading[0, 0])
    cos, sin = np.cos(heading), np.sin(heading)
    in_map = np.array([x[step], y[step]]) + mean @ np.array([[cos, sin], [-sin, cos]])
    assert in_map == pytest.approx(out.mean[0], abs=1e-3)
    errors = np.hypot(*(in_map - np.column_stack([x, y])[step + STRIDE :: STRIDE]).T)
    assert DT * HORIZON == 5.0 and errors[14] < 2.0
