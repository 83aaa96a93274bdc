"""Vehicles and drivers of generated traffic; the drivers are calibrated to NGSIM."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from litsim_sim.core.scene import FloatArray, Kind

PARAMETERS = Path(__file__).parent / "calibration.json"
VEHICLE_CLASS = {Kind.CAR: "passenger", Kind.TRUCK: "truck", Kind.MOTORCYCLE: "motorcycle"}

TIME_GAP_MIN = 0.55  # [s] lower limit on calibrated time gaps: SUMO's merging causes contacts with shorter ones
STANDSTILL_GAP = (1.5, 4.0)  # [m] limits on calibrated gaps: in queues the fits are at their bounds
ACCELERATION = (0.6, 2.2)  # [m/s2] likewise
DECELERATION = (1.0, 3.5)  # [m/s2] likewise
ASSERTIVENESS = (3.0, 6.0)  # factors by which accepted gaps are shorter: at 1 the on-ramp jams, unlike the real one
TRUCK_ACCELERATION, TRUCK_SPEED = 0.7, 0.85  # of trucks, relative to cars


@dataclass(frozen=True)
class Fleet:
    """Composition of the traffic.

    Attributes:
        truck_share, motorcycle_share: shares of all vehicles; the others are cars.
        truck_length: smallest and largest length of trucks [m].
        free_speed: lowest desired speed [m/s]: drivers calibrated in a jam would otherwise never drive faster.
        eagerness: factor on the calibrated eagerness to change lanes for speed, which is of little use before signals.
        drivers: names of the sites whose calibrated drivers drive here.
    """

    truck_share: float
    motorcycle_share: float
    truck_length: tuple[float, float]
    free_speed: float
    eagerness: float
    drivers: tuple[str, ...]


@dataclass(frozen=True)
class Vehicle:
    """One vehicle: class, length and width [m]."""

    kind: Kind
    length: float
    width: float


class CalibratedDrivers(NamedTuple):
    """Drivers that were calibrated to NGSIM.

    Attributes:
        drivers: (n, 5) IDM parameters v0 [m/s], T [s], s0 [m], a_max, b [m/s2], by site of the recorded drivers.
        speed_gain: mean over drivers of SUMO's lcSpeedGain, the eagerness to change lanes for speed.
    """

    drivers: Mapping[str, FloatArray]
    speed_gain: float


@cache
def calibrated() -> CalibratedDrivers:
    """Returns the packaged drivers; ``calibration.json`` says how they were fitted."""
    values = json.loads(PARAMETERS.read_text(encoding="utf-8"))
    drivers = {site: np.array(rows, np.float64) for site, rows in values["drivers"].items()}
    return CalibratedDrivers(drivers, float(values["lcSpeedGain"]))


def draw_vehicle(fleet: Fleet, rng: np.random.Generator) -> Vehicle:
    """Draws a vehicle, its kind and its size, from `fleet`."""
    draw = rng.random()
    if draw < fleet.truck_share:
        length, width = float(rng.uniform(*fleet.truck_length)), float(rng.uniform(2.3, 2.55))
        return Vehicle(Kind.TRUCK, round(length, 2), round(width, 2))
    if draw < fleet.truck_share + fleet.motorcycle_share:
        return Vehicle(Kind.MOTORCYCLE, round(float(rng.uniform(2.1, 2.5)), 2), round(float(rng.uniform(0.7, 0.9)), 2))
    length = float(np.clip(rng.normal(4.75, 0.55), 3.4, 6.2))
    width = float(np.clip(0.95 + 0.2 * length + rng.normal(0.0, 0.1), 1.5, 2.3))
    return Vehicle(Kind.CAR, round(length, 2), round(width, 2))


def vehicle_type(vehicle: Vehicle, fleet: Fleet, rng: np.random.Generator) -> dict[str, str]:
    """Returns the attributes of SUMO's vType for `vehicle` with one of the calibrated drivers, drawn by `rng`."""
    behaviour, draw = calibrated(), rng.random(3)
    drivers = np.concatenate([behaviour.drivers[site] for site in fleet.drivers])
    v0, time_gap, s0, a_max, b = drivers[int(draw[0] * len(drivers))]
    slow = vehicle.kind == Kind.TRUCK
    low, high = ASSERTIVENESS
    return {
        "vClass": VEHICLE_CLASS[vehicle.kind],
        "length": f"{vehicle.length:.2f}",
        "width": f"{vehicle.width:.2f}",
        "carFollowModel": "IDM",
        "tau": f"{max(time_gap, TIME_GAP_MIN):.3f}",
        "minGap": f"{np.clip(s0, *STANDSTILL_GAP):.3f}",
        "accel": f"{np.clip(a_max, *ACCELERATION) * (TRUCK_ACCELERATION if slow else 1.0):.3f}",
        "decel": f"{np.clip(b, *DECELERATION):.3f}",
        "emergencyDecel": "7",
        "maxSpeed": f"{max(v0, fleet.free_speed) * (TRUCK_SPEED if slow else 1.0):.3f}",
        "speedDev": "0.08",
        "lcSpeedGain": f"{fleet.eagerness * behaviour.speed_gain * (0.5 + draw[1]):.3f}",
        "lcKeepRight": "0",  # there is no such rule at these sites
        "lcOvertakeRight": "1",
        "lcAssertive": f"{low + (high - low) * draw[2]:.3f}",
        "lcMaxSpeedLatStanding": "0",  # or vehicles slide sideways in a queue
        "lcMaxSpeedLatFactor": "0.15",
    }
