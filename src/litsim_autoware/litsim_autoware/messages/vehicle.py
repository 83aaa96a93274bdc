"""The ego as Autoware has it: motion of the middle of its rear axle, steering angle, status of lights and gear."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan, cos, sin, tan

import numpy as np

from litsim_autoware.messages.cdr import TIME, Message, header, stamped
from litsim_autoware.messages.objects import quaternions
from litsim_sim.core.scene import STEP_S, AgentTable, EgoCommand, FloatArray

SLOW = 0.1  # [m/s] speed below which the steering angle cannot be told from the motion
FUTURE_S = 0.1  # [s] between the poses of a trajectory for the ego port

ODOMETRY = Message(
    *header("map"),
    ("child", b"base_link"),
    ("position", "(3,)f8"),
    ("orientation", "(4,)f8"),
    ("pose_covariance", "(36,)f8"),
    ("twist", "(6,)f8"),
    ("twist_covariance", "(36,)f8"),
)
ACCELERATION = Message(*header("base_link"), ("acceleration", "(6,)f8"), ("covariance", "(36,)f8"))
TRANSFORM = Message(
    ("count", "u4"),
    *header("odom"),
    ("child", b"base_link"),
    ("position", "(3,)f8"),
    ("orientation", "(4,)f8"),
)
VELOCITY = Message(*header("base_link"), ("longitudinal", "f4"), ("lateral", "f4"), ("heading_rate", "f4"))
STEERING = Message(*TIME, ("angle", "f4"))
REPORT = Message(*TIME, ("report", "u1"))
"""Any of the reports of gear, control mode, turn indicators and hazard lights."""


@dataclass(frozen=True)
class RearAxle:
    """Motion of the middle of the ego's rear axle in frame map: [m], [rad], [m/s], [m/s2], [rad/s]."""

    x: float
    y: float
    yaw: float
    speed: float
    acceleration: float
    yaw_rate: float

    @classmethod
    def of(cls, table: AgentTable, ego_id: int, lever: float) -> RearAxle | None:
        """The motion in `table`, `lever` metres behind the box centre; None if the ego is not on the road."""
        row = table.row(ego_id)
        if row < 0:
            return None
        x, y, yaw, speed, acceleration, yaw_rate = (
            float(getattr(table, name)[row]) for name in ("x", "y", "yaw", "speed", "acceleration", "yaw_rate")
        )
        return cls(x - lever * cos(yaw), y - lever * sin(yaw), yaw, speed, acceleration, yaw_rate)

    def at_rest(self) -> RearAxle:
        """The same place, standing."""
        return replace(self, speed=0.0, acceleration=0.0, yaw_rate=0.0)

    def after(self, time_s: float) -> RearAxle:
        """The motion some time later, at constant acceleration and yaw rate."""
        speed = max(0.0, self.speed + self.acceleration * time_s)
        way, yaw = 0.5 * (self.speed + speed) * time_s, self.yaw + 0.5 * self.yaw_rate * time_s
        return replace(
            self,
            x=self.x + way * cos(yaw),
            y=self.y + way * sin(yaw),
            yaw=self.yaw + self.yaw_rate * time_s,
            speed=speed,
        )

    def steering(self, wheelbase: float) -> float | None:
        """Angle of the tyres [rad]; None if the ego is too slow to tell."""
        return atan(wheelbase * self.yaw_rate / self.speed) if self.speed > SLOW else None

    def odometry(self, stamp_ns: int) -> bytes:
        """``nav_msgs/Odometry`` in frame map, with the twist in frame base_link."""
        twist = (self.speed, 0.0, 0.0, 0.0, 0.0, self.yaw_rate)
        return ODOMETRY.data({**stamped(stamp_ns), **self._pose, "twist": twist})

    def accel(self, stamp_ns: int) -> bytes:
        """``geometry_msgs/AccelWithCovarianceStamped`` in frame base_link."""
        return ACCELERATION.data({**stamped(stamp_ns), "acceleration": (self.acceleration, 0, 0, 0, 0, 0)})

    def transform(self, stamp_ns: int) -> bytes:
        """``tf2_msgs/TFMessage`` from frame odom, which is that of map, to base_link."""
        return TRANSFORM.data({**stamped(stamp_ns), **self._pose, "count": 1})

    def velocity(self, stamp_ns: int) -> bytes:
        """``autoware_vehicle_msgs/VelocityReport``."""
        return VELOCITY.data({**stamped(stamp_ns), "longitudinal": self.speed, "heading_rate": self.yaw_rate})

    @property
    def _pose(self) -> dict[str, FloatArray | tuple[float, float, float]]:
        return {"position": (self.x, self.y, 0.0), "orientation": quaternions(np.array([self.yaw]))[0]}


def steering_report(angle: float, stamp_ns: int) -> bytes:
    """``autoware_vehicle_msgs/SteeringReport`` of an angle of the tyres [rad]."""
    return STEERING.data({**stamped(stamp_ns), "angle": angle})


def report(value: int, stamp_ns: int) -> bytes:
    """``GearReport``, ``ControlModeReport``, ``TurnIndicatorsReport`` or ``HazardLightsReport``."""
    return REPORT.data({**stamped(stamp_ns), "report": value})


def command(step: int, acceleration: float, steering: float, speed: float, wheelbase: float) -> EgoCommand:
    """The answer to a step: an acceleration [m/s2] and an angle of the tyres [rad], at `speed` [m/s].

    The yaw rate is that of the mean speed of the step, at which the ego's model applies it.
    """
    mean = max(0.0, speed + 0.5 * STEP_S * acceleration)
    return EgoCommand(step, acceleration, mean * tan(steering) / wheelbase)


def future_of(points: FloatArray, speeds: FloatArray, now: RearAxle, lever: float, horizon_s: float) -> FloatArray:
    """(k, 3) time from now [s] and position of the box centre [m] on a trajectory of Autoware, every 0.1 s.

    Args:
        points: (n, 2) of the rear axle [m]; the first may lie behind it.
        speeds: (n,) at the points [m/s].
        now: motion of the rear axle.
        lever: from there to the box centre [m].
        horizon_s: latest time [s].

    The way between two points takes as long as at the mean of their speeds; a vehicle that is to start from rest does
    so at 1 m/s2 at least, and one whose trajectory ends with speed 0 stays at its end.
    """
    along = np.append(0.0, np.hypot(*np.diff(points, axis=0).T).cumsum())
    heading = np.unwrap(np.arctan2(*np.gradient(points, axis=0).T[::-1]))
    nearest = int(np.hypot(points[:, 0] - now.x, points[:, 1] - now.y).argmin())
    ahead = (now.x - points[nearest, 0]) * cos(heading[nearest]) + (now.y - points[nearest, 1]) * sin(heading[nearest])
    begin = float(min(along[nearest] + ahead, along[-1]))  # less than 0 where the trajectory begins ahead
    later = along > begin
    way = np.append(begin, along[later])
    speed = np.append(now.speed, speeds[later])
    gap = np.diff(way)
    least = np.sqrt(speed[:-1] ** 2 + 2.0 * gap)  # at 1 m/s2 from the speed before
    mean = np.maximum(0.5 * (speed[:-1] + speed[1:]), np.where(speed[1:] > 0.0, 0.5 * least, 0.05))
    time = np.append(0.0, (gap / mean).cumsum())
    times = np.arange(FUTURE_S, min(horizon_s, max(time[-1], FUTURE_S)) + 1e-9, FUTURE_S)
    s = np.interp(times, time, way)
    x, y, turn = (np.interp(s, along, values) for values in (points[:, 0], points[:, 1], heading))
    x, y = x + np.minimum(s, 0.0) * cos(heading[0]), y + np.minimum(s, 0.0) * sin(heading[0])
    return np.column_stack([times, x + lever * np.cos(turn), y + lever * np.sin(turn)])
