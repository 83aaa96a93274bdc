"""The ego's vehicle model: actuators by their definitions, and the default that changes nothing."""

from dataclasses import fields
from math import exp, inf, nan, tan

import numpy as np
import pytest

from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, STEP_S, AgentTable
from litsim_sim.core.vehicle import VEHICLE_FIELDS, Actuators, VehicleGeometry, VehicleModel

STANDING = (0.0, 0.0)


def response(
    model: VehicleModel, commands: list[tuple[float, float]], moving: tuple[float, float] = STANDING
) -> np.ndarray:
    """What takes effect in each step (n, 2)."""
    actuators = Actuators(model)
    return np.array([actuators.apply(*command, moving, 20.0) for command in commands])


def test_the_default_is_the_vehicle_of_everyone_and_passes_commands_bit_for_bit() -> None:
    for field in fields(VehicleLimits):
        assert getattr(VehicleModel(), field.name) == getattr(VehicleLimits(), field.name)
    commands = [(0.1 + 0.2, -0.3), (-99.0, 7.0), (0.0, 0.0)]
    assert response(VehicleModel(), commands).tolist() == [list(command) for command in commands]


def test_dead_time_keeps_what_was_before() -> None:
    out = response(VehicleModel(delay_s=0.3), [(-2.0, 0.1)] * 6, moving=(0.5, -0.02))
    assert out[:3].tolist() == [[0.5, -0.02]] * 3
    assert out[3:].tolist() == [[-2.0, 0.1]] * 3


def test_lag_is_of_first_order() -> None:
    out = response(VehicleModel(lag_s=0.4), [(-2.0, 0.1)] * 10)
    rise = 1.0 - np.array([exp(-STEP_S * k / 0.4) for k in range(1, 11)])
    assert out[:, 0] == pytest.approx(-2.0 * rise)
    assert out[:, 1] == pytest.approx(0.1 * rise)


def test_jerk_is_bounded_and_the_yaw_rate_is_not() -> None:
    out = response(VehicleModel(jerk_max=5.0), [(-3.0, 0.1)] * 8)
    assert out[:, 0] == pytest.approx([-0.5, -1.0, -1.5, -2.0, -2.5, -3.0, -3.0, -3.0])
    assert (out[:, 1] == 0.1).all()


def test_actuators_do_not_wind_up_beyond_the_limits() -> None:
    model = VehicleModel(jerk_max=10.0, deceleration_max=4.0)
    out = response(model, [(-100.0, 0.0)] * 10 + [(0.0, 0.0)] * 5)
    assert out[:, 0].min() == -4.0
    assert out[10:, 0] == pytest.approx([-3.0, -2.0, -1.0, 0.0, 0.0])


def test_reset_forgets() -> None:
    actuators = Actuators(VehicleModel(delay_s=0.1))
    assert actuators.apply(-2.0, 0.0, (1.0, 0.0), 20.0) == (1.0, 0.0)
    actuators.reset()
    assert actuators.apply(-3.0, 0.0, (0.25, 0.0), 20.0) == (0.25, 0.0)


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({"wheels": 4.0}, "wheels is unknown, expected some of acceleration_max, "),
        ({"curvature_max": 0.0}, r"curvature_max is 0.0, expected a number of more than 0 \[1/m\]"),
        ({"lag_s": -0.1}, r"lag_s is -0.1, expected a number of at least 0 \[s\]"),
        ({"speed_max": inf}, "speed_max is inf, expected a number of more than 0"),
        ({"jerk_max": nan}, "jerk_max is nan, expected a number of more than 0"),
        ({"rear_axle": 0.6}, "rear_axle is 0.6, expected a number of at least 0 and at most 0.5"),
        ({"delay_s": 1e12}, r"delay_s is 1000000000000.0, expected a number of at least 0 and at most 60 \[s\]"),
        ({"delay_s": 0.25}, "delay_s is 0.25, expected a multiple of 0.1 s"),
    ],
)
def test_values_that_make_no_vehicle(values: dict[str, float], error: str) -> None:
    with pytest.raises(ValueError, match=error):
        VehicleModel.of(values)
    assert set(VEHICLE_FIELDS) == {field.name for field in fields(VehicleModel)}


def test_a_truck_is_as_long_as_its_overhangs_and_wheelbase() -> None:
    columns = {name: np.zeros(1, DTYPES[name]) for name in ARRAY_FIELDS}
    columns |= {
        "id": np.array([7]),
        "kind": np.array([1], np.uint8),
        "length": np.array([11.0]),
        "width": np.array([2.5]),
    }
    vehicle = VehicleModel(rear_axle=0.3)
    geometry = VehicleGeometry.of(AgentTable(0, **columns), 7, vehicle)
    assert geometry.rear_overhang + geometry.wheelbase + geometry.front_overhang == pytest.approx(11.0)
    assert geometry.rear_axle_to_centre + geometry.rear_overhang == pytest.approx(5.5)
    assert (geometry.rear_axle_to_centre, geometry.height) == (pytest.approx(3.3), 3.2)
    values = geometry.described(vehicle)
    assert set(VEHICLE_FIELDS) < set(values)
    assert tan(values["steering_angle_max"]) / geometry.wheelbase == pytest.approx(vehicle.curvature_max)
