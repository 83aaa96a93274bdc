import numpy as np
import pytest

from litsim_data.encounters.pace import at_pace
from made_traffic import STREET, Vehicle, braking, lane_y, on_path, situation


def test_a_vehicle_keeps_its_lane_and_its_speed() -> None:
    track = at_pace(situation(braking(1, 10.0, 1.2, [(0, 12), (3, 12), (6, 2), (12, 2)])), 0, 25, 85)
    assert np.allclose(track.x, 40.0 + 1.2 * np.arange(61))
    assert np.allclose(track.y, lane_y(1.2)) and np.allclose(track.speed, 12.0)


def test_a_vehicle_turns_where_it_does_in_the_record() -> None:
    record = on_path(1, ("WA_2", "AAN_0"), 100.0, [(0, 8), (3, 8), (6, 0), (12, 0), (15, 8), (30, 8)])
    track = at_pace(situation(record, lane_map=STREET), 0, 25, 105)
    turned = on_path(1, ("WA_2", "AAN_0"), 100.0, 8.0)
    assert np.hypot(track.x - turned.x[25:106], track.y - turned.y[25:106]).max() < 0.5
    assert track.yaw[-1] == pytest.approx(0.5 * np.pi, abs=0.05)


def test_off_the_lanes_a_vehicle_goes_straight_on() -> None:
    t = 0.1 * np.arange(100)
    track = at_pace(situation(Vehicle(1, 100.0 + 3.0 * t, 50.0 + 4.0 * t)), 0, 40, 60)
    assert np.allclose(np.column_stack([track.x, track.y])[-1], [100.0 + 18.0, 50.0 + 24.0], atol=1e-6)
