"""The ego's size in standard types: where its axles are, and what follows from its model."""

from math import tan

import numpy as np
import pytest

from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, AgentTable
from litsim_sim.core.vehicle import VEHICLE_FIELDS, VehicleModel
from litsim_sim.core.vehicle_geometry import VehicleGeometry


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
