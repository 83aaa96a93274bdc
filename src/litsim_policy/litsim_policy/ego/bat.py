"""The ego `bat`, which drives as a predictor expects: close to its log, yet free to deviate from it.

At every step the predictor (BAT by default) forecasts the ego, which tracks the forecast within the limits of its
vehicle and the edges of the road, and stops at red lights. There is neither car following nor emergency braking, so
that its errors are the predictor's, to which other agents must react.

By default the most probable manoeuvre is forecast, which hardly ever leaves the log. With sampled manoeuvres, the ego
does what the predictor thinks possible, and so departs from its log as often as people differ.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from litsim_policy.ego.ego import Ego
from litsim_policy.motion.car_following import IdmConfig
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.reference_path import ReferencePath, onto_lane, pursuit_yaw_rate
from litsim_policy.motion.stop_lines import StopLines, idm_at_signals
from litsim_predictor.forecast import Forecast, Predictor, Wanted
from litsim_predictor.inference.contract import DT, HORIZON
from litsim_predictor.inference.predictor import LearnedPredictor
from litsim_predictor.models import ModelName, make_predictor
from litsim_sim.core.errors import InputError
from litsim_sim.core.quantities import Length, Positive, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, EgoCommand, FloatArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import Scenario

PREVIEW = 2.0  # [s] first part of the forecast, which the acceleration reproduces
EDGE_MARGIN = 0.2  # [m] distance kept between the ego's sides and the edges of the road
HELD_STEPS = round(HORIZON * DT / STEP_S)  # for which a sampled manoeuvre is kept: those that it is a label of
BACK = -0.5  # cosine of the angle to the present heading (120 degrees) beyond which a step counts as backwards


@configuration
class BatConfig:
    """How forecasts are tracked.

    Attributes:
        predictor: model that forecasts the ego, or a file of weights or of a graph.
        roi_m: distance from the ego within which the predictor sees others; by default as in BAT's training.
        maneuver: which of the ego's manoeuvres is forecast: the `most_probable` one; or one that is `sampled` by its
            probability, every 5 s anew, with the scenario's seed. Models that kernels run, such as `default`, forecast
            the most probable one only.
    """

    predictor: ModelName = "bat"
    roi_m: Positive[Length] = 62.0
    maneuver: Literal["most_probable", "sampled"] = "most_probable"


class BatEgo(Ego):
    """Tracks its own forecast, but stops at red; without a forecast it follows its lane at constant speed."""

    defaults = BatConfig()

    def __init__(self, scenario: Scenario, config: BatConfig | None = None) -> None:
        self._scenario, self._config = scenario, config or BatConfig()
        self._predictor = make_predictor(self._config.predictor, scenario, wanted=Wanted.EGO, roi_m=self._config.roi_m)
        if self._config.maneuver == "sampled":
            self._predictor = SampledManeuvers(self._predictor, scenario, self._config.predictor)
        self._reachable: dict[frozenset[int], LaneMap] = {}
        self._stop_lines = StopLines(scenario.signals)

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.ego.Ego`."""
        forecast = self._predictor.forecast(table)
        row = table.row(self._scenario.ego_id)
        if row < 0 or table.step < self._scenario.history_steps:
            return EgoCommand(table.step)
        x, y, yaw, speed = (float(getattr(table, f)[row]) for f in ("x", "y", "yaw", "speed"))
        points, headings = self._own(forecast, np.array([x, y]), yaw)
        wanted = fitted_acceleration(travelled(points), forecast.dt, speed, PREVIEW)
        wanted = max(wanted, -speed / STEP_S)  # stops, but does not reverse

        road = self._road(points[:1], headings[:1])
        inside = within_edges(road, points, headings, 0.5 * float(table.width[row]) + EDGE_MARGIN)
        path = ReferencePath.through(np.concatenate([inside, onto_lane(road, inside[-1], float(headings[-1]))]))
        turn = pursuit_yaw_rate(path, x, y, yaw, speed)
        follower = PathFollowers(road, table, np.array([row]), path.batch)
        own_speed = np.array([speed])
        wanted = float(
            idm_at_signals(IdmConfig(), own_speed, own_speed, np.array([wanted]), self._stop_lines.of(follower))[0]
        )
        acceleration, yaw_rate = self._scenario.vehicle.within(wanted, turn, speed)
        return EgoCommand(table.step, acceleration, yaw_rate)

    def _road(self, point: FloatArray, heading: FloatArray) -> LaneMap:
        """Map of the lanes reachable from `point` (1, 2) [m] with `heading` (1,) [rad], without ramps beyond a gore."""
        lane_map = self._scenario.lane_map
        rows = lanes_ahead(lane_map, int(lane_map.nearest(point[:, 0], point[:, 1], heading).lane[0]))
        if rows not in self._reachable:
            self._reachable[rows] = LaneMap([lane_map.lanes[row] for row in rows])
        return self._reachable[rows]

    def _own(self, forecast: Forecast, position: FloatArray, yaw: float) -> tuple[FloatArray, FloatArray]:
        """Positions (k + 1, 2) [m] and headings (k + 1,) [rad] of the ego, now and as forecast; k = 0 without one."""
        row = int(forecast.rows(np.array([self._scenario.ego_id]))[0])
        if row < 0:
            return position[None], np.array([yaw])
        points = onward(np.concatenate([position[None], forecast.mean[row]]), yaw)
        headings = forecast.yaw[row].astype(np.float64)
        headings = np.where(np.cos(headings - yaw) > BACK, headings, yaw)
        return points, np.concatenate([[yaw], headings])


class SampledManeuvers:
    """Forecasts of an ego, as if a manoeuvre that is drawn by its probability were the most probable one.

    It is drawn in the step before the ego begins to drive, and every :data:`HELD_STEPS` steps anew.

    Args:
        predictor: that forecasts the ego.
        scenario: whose seed, with the id of the ego, draws.
        name: of the predictor, for errors.

    Raises:
        InputError: the predictor does not forecast manoeuvres that are asked for.
    """

    def __init__(self, predictor: Predictor, scenario: Scenario, name: str) -> None:
        if not (isinstance(predictor, LearnedPredictor) and predictor.decodes_maneuvers):
            raise InputError(
                f"ego: parameter maneuver is sampled, which predictor {name} does not support; expected one that is "
                "run as a graph: bat, cs_lstm, paper, or a file *.onnx"
            )
        self._predictor, self._scenario = predictor, scenario
        self._random = np.random.default_rng([scenario.seed, scenario.ego_id])
        self._maneuver: int | None = None

    def observe(self, table: AgentTable) -> None:
        """See :class:`litsim_predictor.forecast.Predictor`."""
        self._predictor.observe(table)

    def forecast(self, table: AgentTable) -> Forecast:
        """See :class:`litsim_predictor.forecast.Predictor`."""
        forecast = self._predictor.forecast(table, self._maneuver)
        row = int(forecast.rows(np.array([self._scenario.ego_id]))[0])
        if (table.step + 1 - self._scenario.history_steps) % HELD_STEPS == 0 and row >= 0:
            share = forecast.maneuver_probability[row].astype(np.float64)
            self._maneuver = int(self._random.choice(len(share), p=share / share.sum()))
        return forecast


def onward(points: FloatArray, yaw: float) -> FloatArray:
    """`points` (k + 1, 2) without the steps between them that lead backwards, relative to the heading `yaw` [rad]."""
    steps = np.diff(points, axis=0)
    length = np.hypot(steps[:, 0], steps[:, 1])
    forward = steps @ np.array([np.cos(yaw), np.sin(yaw)]) > BACK * length
    return points[0] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps * forward[:, None], axis=0)])


def travelled(points: FloatArray) -> FloatArray:
    """Returns the arc lengths (k,) [m] along `points` (k + 1, 2) from the first to each of the others."""
    return np.cumsum(np.hypot(*np.diff(points, axis=0).T))


def fitted_acceleration(way: FloatArray, dt: float, speed: float, preview: float) -> float:
    """Constant acceleration [m/s2] that fits the arc lengths `way` (k,) [m] over `preview` [s] by least squares."""
    count = min(len(way), max(1, round(preview / dt)))
    t = dt * np.arange(1, count + 1)
    gain = 0.5 * t**2
    return float(gain @ (way[:count] - speed * t) / (gain @ gain)) if count else 0.0


def lanes_ahead(lane_map: LaneMap, start: int) -> frozenset[int]:
    """Returns rows of the lanes that are reachable from the lane in row `start` over neighbours and successors."""
    reachable, new = {start}, [start]
    while new:
        lane = lane_map.lanes[new.pop()]
        names = [name for name in (lane.left, lane.right, *lane.successors) if name is not None]
        more = {lane_map.row(name) for name in names} - reachable
        reachable |= more
        new += more
    return frozenset(reachable)


def within_edges(lane_map: LaneMap, points: FloatArray, headings: FloatArray, beside: float) -> FloatArray:
    """Move those of `points` (k, 2) inwards that are nearer than `beside` [m] to an edge of the road, or beyond it.

    An edge is a side of a lane without a neighbour. In a lane narrower than twice `beside`, points move to the centre.
    """
    nearest = lane_map.nearest(points[:, 0], points[:, 1], headings)
    lanes = [lane_map.lanes[row] for row in nearest.lane]
    room = np.maximum(0.5 * np.array([lane.width for lane in lanes]) - beside, 0.0)
    low = np.where([lane.right is None for lane in lanes], -room, -np.inf)
    high = np.where([lane.left is None for lane in lanes], room, np.inf)
    aside = np.clip(nearest.d, low, high) - nearest.d
    return points + aside[:, None] * np.column_stack([-np.sin(nearest.heading), np.cos(nearest.heading)])
