"""CommonRoad's reactive planner (Werling et al. 2012: quintic polynomials along a reference path) drives the ego."""

from __future__ import annotations

import logging
import warnings
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import shapely
from commonroad.scenario.lanelet import Lanelet, LaneletNetwork
from commonroad.scenario.scenario import Scenario
from commonroad_dc import pycrcc
from commonroad_rp.reactive_planner import ReactivePlanner
from commonroad_rp.state import ReactivePlannerState
from commonroad_rp.utility.config import ReactivePlannerConfiguration
from commonroad_rp.utility.utils_coordinate_system import create_coordinate_system
from conversions import STEP_S, Ego, ahead_and_left, braking, lengthened, predicted, sampled

STEPS = 30  # of the horizon
SEAM = 0.4  # [m] by which lanes side by side may gape
SIDE = 0.5  # [m] to the left and right of the reference path that end points are sampled
DECELERATION_MAX, ACCELERATION_MAX = 6.0, 3.0  # [m/s2] that speeds are sampled for
LATEST = 6.0  # [m/s2] of braking where there is no solution
GAP_S, GAP = 0.6, 2.0  # time [s] at the ego's speed and distance [m] that it keeps at the end of the horizon,
GAP_SIDE = 0.3  # [m] and to the side
SIGHT, REAR = 80.0, 40.0  # [m] ahead and behind within which objects count
ENDS = 60.0  # [m] by which the reference path is made longer than the route, for whatever is projected on it
SPACING = 2.0  # [m] between the points of the reference path
NO_SAMPLE = "no sample is feasible and free of collisions"
OFF_PLAN, OFF_SPEED = 0.5, 1.0  # [m], [m/s] from the plan beyond which the next one begins at the measured state


@dataclass(frozen=True)
class Body:
    """The ego's box and axles [m], and its limits, called as in `/litsim/ego/vehicle`."""

    length: float
    width: float
    wheelbase: float
    rear_axle_to_centre: float
    steering_angle_max: float  # [rad]
    deceleration_max: float  # [m/s2]


@dataclass(frozen=True)
class Plan:
    """A plan for the ego.

    Attributes:
        points: (n, 2) box centres [m], 0.1 s apart and from now on.
        seconds: time that planning took; 0 for the rest of an earlier plan.
        fault: why it is not the planner's; empty if it is.
        close: whether it keeps no distance, because no plan that does was found.
    """

    points: np.ndarray
    seconds: float
    fault: str = ""
    close: bool = False


class Planner:
    """Plans along a route on the lanes of a map, at most at `wanted` m/s."""

    def __init__(self, route: np.ndarray, lanes: list, body: Body, wanted: float) -> None:
        logging.getLogger("RP_LOGGER").setLevel(logging.ERROR)
        self._body, self._wanted = body, wanted
        self._rear = body.rear_axle_to_centre
        self._config = _configuration(body, lanes)
        self._road = _road_borders(lanes)
        with warnings.catch_warnings():  # of the spline that it fits; straight roads have no radius
            warnings.simplefilter("ignore")
            self._system = create_coordinate_system(sampled(lengthened(route, ENDS, ENDS), SPACING))
        self._planner = ReactivePlanner(self._config)
        self._states: list[ReactivePlannerState] = []  # of the last plan,
        self._step = 0  # from this step on
        self._line = route

    def plan(self, step: int, ego: Ego, objects: np.ndarray) -> Plan:
        """Plan for a step from the ego's state there, or from the last plan if the ego is on it.

        First with the distance to others that it is to keep, then with none, at last it brakes along the last plan.
        """
        begin = perf_counter()
        states, fault, start = [], NO_SAMPLE, self._start(step, ego)
        for keep in (1.0, 0.0):
            try:
                states = self._states_from(start, self._checker(ego, objects, keep))
            except Exception as error:  # noqa: BLE001 - it raises bare ones, of a state that cannot be projected, say
                fault = f"{type(error).__name__}: {error}"
            if states:
                break
        self._states, self._step = states, step
        if not states:
            points = braking(self._line, ego, LATEST, STEPS + 1)
            return Plan(points, perf_counter() - begin, fault)
        points = np.array([self._centre(state) for state in states])
        self._line = _moving(points, self._line)
        return Plan(points, perf_counter() - begin, close=keep == 0.0)

    def _states_from(self, start: ReactivePlannerState, checker: pycrcc.CollisionChecker) -> list:
        planner = self._planner
        planner.reset(self._config, initial_state_cart=start, collision_checker=checker, coordinate_system=self._system)
        speed = max(start.velocity, 0.01)  # of 0 it would look for the goal of a planning problem
        planner.set_desired_velocity(desired_velocity=self._wanted, current_speed=speed)
        reach = STEPS * STEP_S
        low, high = max(0.0, speed - DECELERATION_MAX * reach), speed + ACCELERATION_MAX * reach
        planner.set_v_sampling_parameters(low, min(high, max(self._wanted, low)))
        planned = planner.plan()
        return [] if planned is None else planned[0].state_list

    def _start(self, step: int, ego: Ego) -> ReactivePlannerState:
        if 0 < step - self._step < len(self._states):
            planned = self._states[step - self._step]
            x, y = self._centre(planned)
            if np.hypot(x - ego.x, y - ego.y) < OFF_PLAN and abs(planned.velocity - ego.speed) < OFF_SPEED:
                return _copy(planned)
        wheelbase = self._config.vehicle.wheelbase
        return ReactivePlannerState(
            time_step=0,
            position=np.array([ego.x, ego.y]) - self._rear * np.array([np.cos(ego.yaw), np.sin(ego.yaw)]),
            orientation=ego.yaw,
            velocity=ego.speed,
            acceleration=0.0,
            steering_angle=float(np.arctan2(wheelbase * ego.yaw_rate, max(ego.speed, 1.0))),
            yaw_rate=ego.yaw_rate,
        )

    def _checker(self, ego: Ego, objects: np.ndarray, keep: float) -> pycrcc.CollisionChecker:
        """The road's borders and all relevant agents, at constant velocity.

        Agents that follow on the ego's track are assumed to keep their distance. Boxes grow sideways with time, those
        ahead on its track backwards, too, up to `keep` times the distances that the ego keeps; initially they have
        their true sizes, else an ego that is already close would find no plan.
        """
        ahead, left = ahead_and_left(objects, ego)
        on_track = np.abs(left) < 0.5 * (objects["width"] + self._body.width)
        matters = (ahead > -REAR) & (ahead < SIGHT) & ~(on_track & (ahead < 0.0))
        objects, in_front = objects[matters], on_track[matters]
        times = STEP_S * np.arange(STEPS + 1)
        grown = keep * (GAP + GAP_S * ego.speed) * times / times[-1]
        wider = (keep * GAP_SIDE * times / times[-1]).tolist()
        checker = pycrcc.CollisionChecker()
        checker.add_collision_object(self._road)
        for row, way in enumerate(predicted(objects, times)):
            yaw, length, width = (float(objects[name][row]) for name in ("yaw", "length", "width"))
            longer = grown * in_front[row]
            moving = pycrcc.TimeVariantCollisionObject(0)
            for (x, y), more, side in zip(way.tolist(), longer.tolist(), wider, strict=True):
                back = 0.5 * more
                box = pycrcc.RectOBB(
                    0.5 * length + back, 0.5 * width + side, yaw, x - back * np.cos(yaw), y - back * np.sin(yaw)
                )
                moving.append_obstacle(box)
            checker.add_collision_object(moving)
        return checker

    def _centre(self, state: ReactivePlannerState) -> tuple[float, float]:
        moved = ReactivePlannerState.shift_state_to_center(state, self._rear)
        return float(moved.position[0]), float(moved.position[1])


def _configuration(body: Body, lanes: list) -> ReactivePlannerConfiguration:
    config = ReactivePlannerConfiguration()
    config.planning.dt, config.planning.time_steps_computation = STEP_S, STEPS
    config.sampling.d_min, config.sampling.d_max = -SIDE, SIDE
    config.sampling.t_min, config.sampling.num_sampling_levels = 1.0, 3
    config.debug.multiproc, config.debug.logging_level = False, "ERROR"
    vehicle = config.vehicle
    vehicle.length, vehicle.width = body.length, body.width
    vehicle.wb_rear_axle = body.rear_axle_to_centre
    vehicle.wb_front_axle = body.wheelbase - body.rear_axle_to_centre
    vehicle.delta_max, vehicle.delta_min = body.steering_angle_max, -body.steering_angle_max
    vehicle.a_max = body.deceleration_max
    vehicle.__post_init__()  # the wheelbase follows
    network = LaneletNetwork()
    for number, (left, centre, right) in enumerate(lanes, start=1):
        network.add_lanelet(Lanelet(left, centre, right, number))
    scenario = Scenario(dt=STEP_S)
    scenario.add_objects(network)
    config.update(scenario=scenario)
    return config


def _road_borders(lanes: list) -> pycrcc.ShapeGroup:
    """The borders of lanes with no other lane beyond them.

    The planner's own road boundary takes the seams between lanes, and the ends of the map, for borders as well.
    """
    areas = [shapely.Polygon(np.concatenate([left, right[::-1]])).buffer(SEAM) for left, _, right in lanes]
    group = pycrcc.ShapeGroup()
    for number, (left, _, right) in enumerate(lanes):
        others = shapely.union_all(areas[:number] + areas[number + 1 :])
        for border in (left, right):
            outer = shapely.LineString(border).difference(others)
            for part in shapely.get_parts(outer):
                for (x, y), (u, v) in zip(part.coords[:-1], part.coords[1:], strict=True):
                    half, yaw = 0.5 * np.hypot(u - x, v - y), np.arctan2(v - y, u - x)
                    group.add_shape(pycrcc.RectOBB(half, 0.01, yaw, 0.5 * (x + u), 0.5 * (y + v)))
    return group


def _copy(state: ReactivePlannerState) -> ReactivePlannerState:
    """The state at time step 0, at which every plan begins."""
    names = ("position", "orientation", "velocity", "acceleration", "steering_angle", "yaw_rate")
    return ReactivePlannerState(time_step=0, **{name: getattr(state, name) for name in names})


def _moving(points: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """The points of a plan without those at standstill; `otherwise` if fewer than two are left."""
    kept = points[np.append(True, np.hypot(*np.diff(points, axis=0).T) > 1e-2)]
    return kept if len(kept) > 1 else otherwise
