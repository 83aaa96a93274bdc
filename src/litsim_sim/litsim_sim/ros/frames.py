"""The ego's frames and size in standard types: /tf, footprint and a table of values.

Frame ``map`` is that of the net, ``odom`` the same; ``base_link`` is the middle of the ego's rear axle, and ``ego`` the
centre of its box. ``tf2_msgs`` is optional: stock ROS 2 has it, the wheels do not.
"""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point32, PolygonStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from litsim_sim.core.vehicle import VehicleGeometry, VehicleModel
from litsim_sim.ros.endpoints import publisher_on
from litsim_sim.ros.messages import header
from litsim_sim.ros.topics import FRAMES, TF, TF_STATIC

ODOM, REAR_AXLE, BOX_CENTRE = "odom", "base_link", "ego"
WITHOUT_TF = "tf2_msgs is not installed: without /tf, viewers cannot follow the ego (docs/ego-interface.md)"


def vehicle_table(geometry: VehicleGeometry, vehicle: VehicleModel) -> DiagnosticArray:
    """The sizes and limits of the ego by name, as decimal numbers in SI units."""
    values = [KeyValue(key=name, value=repr(value)) for name, value in geometry.described(vehicle).items()]
    return DiagnosticArray(header=header(0), status=[DiagnosticStatus(name="litsim: ego vehicle", values=values)])


def footprint(geometry: VehicleGeometry) -> PolygonStamped:
    """The corners of the ego's box in frame ``base_link``, counter-clockwise from the front left one."""
    front = geometry.wheelbase + geometry.front_overhang
    side, rear = 0.5 * geometry.width, -geometry.rear_overhang
    message = PolygonStamped(header=header(0))
    message.header.frame_id = REAR_AXLE
    message.polygon.points = [
        Point32(x=x, y=y) for x, y in ((front, side), (rear, side), (rear, -side), (front, -side))
    ]
    return message


def fixed_frames(rear_axle_to_centre: float) -> Any:
    """``tf2_msgs/TFMessage`` of the frames that do not move: map to odom, base_link to ego, by a distance [m]."""
    odom = TransformStamped(header=header(0), child_frame_id=ODOM)
    centre = TransformStamped(header=header(0), child_frame_id=BOX_CENTRE)
    centre.header.frame_id = REAR_AXLE
    centre.transform.translation.x = rear_axle_to_centre
    return TF_STATIC.type(transforms=[odom, centre])


class FrameBroadcaster:
    """Publishes the ego's frames on /tf and /tf_static; does nothing where ``tf2_msgs`` is not installed."""

    def __init__(self, node: Node, geometry: VehicleGeometry) -> None:
        self._lever = geometry.rear_axle_to_centre
        self._to = {topic: publisher_on(node, topic) for topic in FRAMES}
        if not FRAMES:
            node.get_logger().debug(WITHOUT_TF)

    def begin(self) -> None:
        """Publish the frames that do not move."""
        if TF_STATIC in self._to:
            self._to[TF_STATIC].publish(fixed_frames(self._lever))

    def show(self, state: Odometry) -> None:
        """Publish the frame of the ego at a step, by its odometry of the box centre, if anybody listens."""
        if TF not in self._to or not self._to[TF].get_subscription_count():
            return
        moving = TransformStamped(child_frame_id=REAR_AXLE)
        moving.header.stamp, moving.header.frame_id = state.header.stamp, ODOM
        moving.transform.rotation = turn = state.pose.pose.orientation
        place, to = state.pose.pose.position, moving.transform.translation
        to.x = place.x - self._lever * (1.0 - 2.0 * turn.z**2)
        to.y = place.y - self._lever * 2.0 * turn.z * turn.w
        self._to[TF].publish(TF.type(transforms=[moving]))
