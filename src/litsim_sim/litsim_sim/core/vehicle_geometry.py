"""Size of the ego's vehicle: its box, and where its axles are."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import atan

from litsim_sim.core.scene import AgentTable, Kind
from litsim_sim.core.vehicle import VehicleModel

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
