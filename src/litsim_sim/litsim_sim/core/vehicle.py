"""The ego's vehicle: its limits, its size, and how its actuators follow a command."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, fields
from math import atan, exp, inf
from typing import Annotated

import numpy as np
from pydantic import Field, Strict, ValidationError, model_validator

from litsim_sim.core.dynamics import SPEED_MIN, VehicleLimits
from litsim_sim.core.parameters import problems
from litsim_sim.core.quantities import Duration, NonNegative, Unit, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, Kind

DELAY_TOLERANCE = 1e-6  # of a step


@configuration
class VehicleModel(VehicleLimits):
    """A kinematic bicycle behind actuators; the defaults are the vehicle of every controlled agent, without actuators.

    A command passes a dead time, a first-order lag and a bound on jerk, then the limits. Everything is deterministic.

    Attributes:
        jerk_max: bound on the change of the acceleration; infinite for none.
        delay_s: dead time of acceleration and yaw rate, whole steps of 0.1 s, at most a minute.
        lag_s: time constant of their first-order lag.
    """

    jerk_max: Annotated[float, Strict(), Field(gt=0, allow_inf_nan=True), Unit("m/s3")] = inf
    delay_s: Annotated[Duration, Field(ge=0, le=60.0)] = 0.0
    lag_s: NonNegative[Duration] = 0.0

    @model_validator(mode="after")
    def _check(self) -> VehicleModel:
        if abs(self.delay_s / STEP_S - self.delay_steps) > DELAY_TOLERANCE:
            raise ValueError(f"delay_s is {self.delay_s:g}, expected a multiple of {STEP_S:g} s")
        return self

    @classmethod
    def of(cls, values: dict[str, float]) -> VehicleModel:
        """Returns the default vehicle with `values`, by name, in place of defaults; raises ValueError if unfit."""
        if unknown := sorted(values.keys() - set(VEHICLE_FIELDS)):
            raise ValueError(f"{', '.join(unknown)} is unknown, expected some of {', '.join(VEHICLE_FIELDS)}")
        try:
            return cls(**values)
        except ValidationError as error:
            raise ValueError("; ".join(problems(error, cls, values))) from error

    @property
    def delay_steps(self) -> int:
        """The dead time in steps, rounded to whole ones."""
        return round(self.delay_s / STEP_S)

    @property
    def reaction_s(self) -> float:
        """Sum of dead time and lag [s]: about how far a controller has to look ahead."""
        return self.delay_s + self.lag_s

    def possible(self, acceleration: float) -> float:
        """Returns an acceleration [m/s2] cut to the limits."""
        return min(max(acceleration, -self.deceleration_max), self.acceleration_max)

    def within(self, acceleration: float, yaw_rate: float, speed: float) -> tuple[float, float]:
        """Returns an acceleration [m/s2] and a yaw rate [rad/s] cut to the limits at `speed` [m/s]."""
        turn = min(speed * self.curvature_max, self.lateral_acceleration_max / max(speed, SPEED_MIN))
        return self.possible(acceleration), min(max(yaw_rate, -turn), turn)


VEHICLE_FIELDS: tuple[str, ...] = tuple(field.name for field in fields(VehicleModel))


class Actuators:
    """Actuators between the ego's command and its motion; without actuators in the model, commands pass unchanged."""

    def __init__(self, model: VehicleModel) -> None:
        self._model = model
        self._ideal = model.delay_steps == 0 and model.lag_s == 0.0 and model.jerk_max == inf
        self._gain = 1.0 - exp(-STEP_S / model.lag_s) if model.lag_s > 0.0 else 1.0
        self._queue: deque[tuple[float, float]] = deque()
        self._now: tuple[float, float] | None = None

    def reset(self) -> None:
        """Forget commands that have not taken effect, and the state of the lag: the vehicle is no longer driven."""
        self._queue.clear()
        self._now = None

    def apply(
        self, acceleration: float, yaw_rate: float, moving: tuple[float, float], speed: float
    ) -> tuple[float, float]:
        """Returns the acceleration and yaw rate that the actuators make of a command in one step, before any limits.

        They begin with those of the vehicle now, `moving`. Units are [m/s2], [rad/s] and [m/s].
        """
        if self._ideal:
            return acceleration, yaw_rate
        if self._now is None:
            self._now = self._model.within(*moving, speed)
            self._queue.extend([self._now] * self._model.delay_steps)
        self._queue.append(self._model.within(acceleration, yaw_rate, speed))
        wanted = self._queue.popleft()
        change = [self._gain * (to - value) for to, value in zip(wanted, self._now, strict=True)]
        most = self._model.jerk_max * STEP_S
        self._now = (self._now[0] + float(np.clip(change[0], -most, most)), self._now[1] + change[1])
        return self._now


HEIGHTS = {
    Kind.CAR: 1.5,
    Kind.TRUCK: 3.2,
    Kind.MOTORCYCLE: 1.5,
    Kind.BICYCLE: 1.7,
    Kind.PEDESTRIAN: 1.7,
    Kind.UNKNOWN: 1.5,
}
"""[m] Height of an agent by its kind, which recordings do not have."""
FRONT_AXLE = 0.29  # distance of the front axle ahead of the box centre, as a share of the length
TRACK = 0.85  # distance between the wheels of an axle, as a share of the width


@dataclass(frozen=True)
class VehicleGeometry:
    """Size of a vehicle [m].

    Attributes:
        length, width, height: of its box.
        wheelbase: from the rear to the front axle.
        front_overhang, rear_overhang: from the axle to the end of the box.
        track: between the wheels of an axle.
        rear_axle_to_centre: from the rear axle to the box centre.
    """

    length: float
    width: float
    height: float
    wheelbase: float
    front_overhang: float
    rear_overhang: float
    track: float
    rear_axle_to_centre: float

    @classmethod
    def of(cls, table: AgentTable, agent: int, vehicle: VehicleModel) -> VehicleGeometry:
        """The size of `agent`, which is on the road in `table`, as the model of its `vehicle` has it."""
        row = table.row(agent)
        length, width = float(table.length[row]), float(table.width[row])
        rear = vehicle.rear_axle * length
        return cls(
            length=length,
            width=width,
            height=HEIGHTS[Kind(int(table.kind[row]))],
            wheelbase=rear + FRONT_AXLE * length,
            front_overhang=(0.5 - FRONT_AXLE) * length,
            rear_overhang=0.5 * length - rear,
            track=TRACK * width,
            rear_axle_to_centre=rear,
        )

    def described(self, vehicle: VehicleModel) -> dict[str, float]:
        """The sizes [m], the largest steering angle [rad], and the fields of the model of its `vehicle`, by name."""
        steering = {"steering_angle_max": atan(vehicle.curvature_max * self.wheelbase)}
        return asdict(self) | steering | asdict(vehicle)
