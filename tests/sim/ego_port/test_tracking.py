"""Tracking of trajectories and target speeds, closed over the very vehicle that the world moves."""

from collections.abc import Callable

import numpy as np
import pytest

from litsim_sim.core.dynamics import Motion, bicycle_step
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.vehicle import Actuators, VehicleModel
from litsim_sim.ego_port.tracking import EgoState, Reference, Trajectory, TwistTarget, follow_twist

Plan = Callable[[float, float, float, np.ndarray], np.ndarray]
LENGTH = 4.5
REAR = 0.29 * LENGTH


def drive(trajectory: Trajectory, ego: EgoState, model: VehicleModel, steps: int) -> list[EgoState]:
    """The ego after every step of tracking one trajectory."""
    reference, actuators = Reference(trajectory, ego), Actuators(model)
    moving, states = (0.0, 0.0), []
    for _ in range(steps):
        effect = actuators.apply(*reference.command(ego, model), moving, ego.speed)
        motion = Motion(*(np.array([v]) for v in (ego.x, ego.y, ego.yaw, ego.speed, *moving)))
        after = bicycle_step(motion, np.array([LENGTH]), *(np.array([v]) for v in effect), model)
        moving = float(after.acceleration[0]), float(after.yaw_rate[0])
        values = (float(getattr(after, name)[0]) for name in ("x", "y", "yaw", "speed"))
        ego = EgoState(ego.time + STEP_S, *values, LENGTH)
        states.append(ego)
    return states


def errors(trajectory: Trajectory, states: list[EgoState]) -> np.ndarray:
    """Distance to the trajectory at each step [m]."""
    times = [state.time for state in states]
    dx = np.interp(times, trajectory.time, trajectory.x) - [state.x for state in states]
    dy = np.interp(times, trajectory.time, trajectory.y) - [state.y for state in states]
    return np.hypot(dx, dy)


def straight(speed: float, seconds: float = 10.0, dt: float = 0.1, acceleration: float = 0.0) -> Trajectory:
    time = np.arange(0.0, seconds + dt / 2, dt)
    return Trajectory(time, speed * time + 0.5 * acceleration * time**2, np.zeros(len(time)))


MODELS = [VehicleModel(), VehicleModel(delay_s=0.2, lag_s=0.2, jerk_max=20.0)]


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dt", [0.1, 0.5])
def test_a_feasible_start_is_followed(model: VehicleModel, dt: float) -> None:
    trajectory = straight(10.0, dt=dt, acceleration=1.0)
    states = drive(trajectory, EgoState(0.0, 0.0, 0.0, 0.0, 10.0, LENGTH), model, 80)
    assert errors(trajectory, states).max() < 0.45
    assert states[-1].speed == pytest.approx(18.0, abs=0.3)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("radius", "speed"), [(30.0, 8.0), (12.0, 5.0), (200.0, 25.0)])
def test_a_bend_is_followed_by_the_centre_of_the_box(model: VehicleModel, radius: float, speed: float) -> None:
    """The rear axle turns on the smaller circle; the reference is the path of the centre."""
    time = np.arange(0.0, 8.05, 0.1)
    angle = speed * time / radius
    trajectory = Trajectory(time, radius * np.sin(angle), radius * (1.0 - np.cos(angle)))
    yaw = -float(np.arcsin(REAR / radius))
    states = drive(trajectory, EgoState(0.0, 0.0, 0.0, yaw, speed, LENGTH), model, 78)
    assert errors(trajectory, states).max() < 0.8
    assert errors(trajectory, states)[40:].max() < 0.15


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("speed", [3.0, 12.0, 30.0])
def test_an_offset_fades_without_ringing(model: VehicleModel, speed: float) -> None:
    trajectory = straight(speed)
    states = drive(trajectory, EgoState(0.0, -1.0, 1.0, 0.0, speed, LENGTH), model, 95)
    y = np.array([state.y for state in states])
    assert abs(y[-20:]).max() < 0.1
    assert y.min() > -0.2
    assert errors(trajectory, states)[-1] < 0.15


def along(radius: float, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of a lane that bends to the left, as complex numbers, and its headings; straight for no radius."""
    heading = s / radius
    return s * np.sinc(heading / (2.0 * np.pi)) * np.exp(0.5j * heading), heading


def frenet(left: float, yaw: float, speed: float, time: np.ndarray) -> np.ndarray:
    """Distances to the left of the lane: they fade from those of the ego, that moves as its body heads."""
    return (left * (1.0 + time) + speed * np.sin(yaw) * time) * np.exp(-time)


def centre(_left: float, _yaw: float, _speed: float, time: np.ndarray) -> np.ndarray:
    return 0.0 * time


@pytest.mark.parametrize("first", [0.0, 0.1])
@pytest.mark.parametrize("speed", [2.0, 4.0, 7.0, 12.0, 25.0])
@pytest.mark.parametrize(("plan", "bend_error"), [(frenet, 1.1), (centre, 0.25)])
def test_a_stack_that_plans_anew_at_every_step(plan: Plan, bend_error: float, speed: float, first: float) -> None:
    """From 1.2 m beside its lane it comes back to it, and in a bend it stays on it."""
    time, lane = np.arange(first, 4.0, 0.1), np.arange(-10.0, 12.0 * speed + 40.0, 0.02)

    def lefts(radius: float, left: float) -> np.ndarray:
        points, headings = along(radius, lane)
        ego, states = EgoState(0.0, 0.0, left, 0.0, speed, LENGTH), []
        for _ in range(120):
            at = complex(ego.x, ego.y)
            here = int(np.argmin(np.abs(points - at)))
            states.append(((at - points[here]) * np.exp(-1j * headings[here])).imag)
            places, heading = along(radius, lane[here] + speed * time)
            places = places + 1j * plan(states[-1], ego.yaw - headings[here], speed, time) * np.exp(1j * heading)
            (ego,) = drive(Trajectory(ego.time + time, places.real, places.imag), ego, VehicleModel(), 1)
        return np.array(states)

    assert abs(lefts(np.inf, 1.2)[-30:]).max() < 0.1
    assert abs(lefts(max(8.0, speed**2 / 2.5), 0.0)).max() < bend_error


def test_it_stops_where_the_trajectory_does_and_stays() -> None:
    time = np.arange(0.0, 10.05, 0.1)
    moving = np.minimum(time, 4.0)
    trajectory = Trajectory(time, 8.0 * moving - moving**2, np.zeros(len(time)))
    states = drive(trajectory, EgoState(0.0, 0.0, 0.0, 0.0, 8.0, LENGTH), VehicleModel(), 95)
    assert states[-1].speed == pytest.approx(0.0, abs=0.02)
    assert states[-1].x == pytest.approx(16.0, abs=0.1)
    assert states[-1].yaw == pytest.approx(0.0, abs=1e-6)


def test_once_it_is_over_the_ego_brakes_on_the_last_arc() -> None:
    time = np.arange(0.0, 2.05, 0.1)
    angle = 10.0 * time / 50.0
    trajectory = Trajectory(time, 50.0 * np.sin(angle), 50.0 * (1.0 - np.cos(angle)))
    states = drive(trajectory, EgoState(0.0, 0.0, 0.0, 0.0, 10.0, LENGTH), VehicleModel(), 80)
    assert states[-1].speed == 0.0
    assert np.diff([state.speed for state in states[21:60]]) == pytest.approx(-0.2)
    away = [np.hypot(state.x, state.y - 50.0) for state in states]
    assert np.array(away) == pytest.approx(50.0, abs=0.6)


def test_commands_are_within_the_limits() -> None:
    model = VehicleModel(acceleration_max=1.0, deceleration_max=2.0, lateral_acceleration_max=2.0)
    ego = EgoState(0.0, -1.5, 1.0, 0.4, 10.0, LENGTH)
    for speed in (0.0, 30.0):
        acceleration, yaw_rate = Reference(straight(speed), ego).command(ego, model)
        assert -2.0 <= acceleration <= 1.0
        assert abs(yaw_rate) * 10.0 <= 2.0 + 0.2


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ((), ""),
        ((("x", slice(3, None), 25.0),), "it jumps by 26.00 m within 0.1 s up to 0.3 s, expected at most 1.42 m"),
        ((("y", slice(None), 3.0),), "it is 3.0 m away from the ego, expected at most 2 m"),
        ((("time", slice(None), -20.0),), "its last pose is for -10.0 s, expected one after 0.0 s"),
        ((("time", slice(None), 0.1),), ""),
        ((("time", slice(None), 10.0),), ""),
        (
            (("time", slice(None), 1.7e9),),
            "its first pose is for 1700000000.0 s, expected one for 10.0 s or earlier: stamps are in simulation time",
        ),
    ],
)
def test_what_no_vehicle_can_do(change: tuple[tuple[str, slice, float], ...], problem: str) -> None:
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 10.0, LENGTH)
    trajectory = straight(10.0)
    for name, where, by in change:
        getattr(trajectory, name)[where] += by
    assert Reference(trajectory, ego).problem(ego, VehicleModel()) == problem


@pytest.mark.parametrize(("poses", "said"), [(0, "it holds no poses"), (1, "its last pose is for 0.0 s")])
def test_a_trajectory_of_nearly_nothing(poses: int, said: str) -> None:
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 10.0, LENGTH)
    none = Trajectory(*(np.zeros(poses) for _ in range(3)))
    assert said in Reference(none, ego).problem(ego, VehicleModel())


def test_one_pose_ahead_is_enough() -> None:
    ego = EgoState(5.0, 0.0, 0.0, 0.0, 10.0, LENGTH)
    reference = Reference(Trajectory(np.array([6.0]), np.array([10.0]), np.array([0.0])), ego)
    assert reference.problem(ego, VehicleModel()) == ""
    assert reference.command(ego, VehicleModel()) == pytest.approx((0.0, 0.0))


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        (TwistTarget(10.2, 0.1), (2.0, 0.1)),
        (TwistTarget(30.0, 0.0), (4.0, 0.0)),
        (TwistTarget(-5.0, 0.0), (-8.0, 0.0)),
        (TwistTarget(10.0, 3.0), (0.0, 0.489)),
    ],
)
def test_twist(target: TwistTarget, expected: tuple[float, float]) -> None:
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 10.0, LENGTH)
    assert follow_twist(target, ego, VehicleModel()) == pytest.approx(expected)


@pytest.mark.parametrize(("speed", "target"), [(5.0, 45.0), (1.0, 0.0), (5.0, -20.0)])
def test_a_target_speed_out_of_reach_costs_no_yaw_rate(speed: float, target: float) -> None:
    """What the vehicle can turn in a step depends on the speed that it has in that step."""
    ego, model = EgoState(0.0, 0.0, 0.0, 0.0, speed, LENGTH), VehicleModel()
    asked = follow_twist(TwistTarget(target, 9.0), ego, model)
    motion = Motion(*(np.array([v]) for v in (ego.x, ego.y, ego.yaw, ego.speed, 0.0, 0.0)))
    turned = [
        float(bicycle_step(motion, np.array([LENGTH]), np.array([asked[0]]), np.array([rate]), model).yaw_rate[0])
        for rate in (asked[1], 9.0)
    ]
    assert turned[0] == turned[1] > 0.1


def test_a_trajectory_that_is_too_fast_is_steered_to_all_the_same() -> None:
    model, ego = VehicleModel(), EgoState(0.0, 0.0, -1.0, -0.5, 5.0, LENGTH)
    assert Reference(straight(30.0), ego).command(ego, model) == pytest.approx(model.within(9.0, 9.0, 5.2))


def test_twist_settles_behind_slow_actuators() -> None:
    model = VehicleModel(delay_s=0.3, lag_s=0.3)
    actuators, speed, seen = Actuators(model), 10.0, []
    for _ in range(100):
        ego = EgoState(0.0, 0.0, 0.0, 0.0, speed, LENGTH)
        command = follow_twist(TwistTarget(12.0, 0.0), ego, model)
        speed += STEP_S * actuators.apply(*command, (0.0, 0.0), speed)[0]
        seen.append(speed)
    assert max(seen) < 12.2
    assert seen[-1] == pytest.approx(12.0, abs=0.01)
