"""A driving system on standard messages alone that cuts in: into the lane beside with the most room, every six seconds.

It drives as minimal_ads.py does, looks into the lanes of `/litsim/lanes` that are on its route, and cares little for
those behind: 3.5 m to those beside, bumper to bumper, are enough for it.
"""

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

WANTED, HEADWAY = 15.0, 1.2  # [m/s], [s]
WIDTH, BESIDE = 3.66, 3.5  # [m] between lanes; to vehicles beside, bumper to bumper
BEGIN_S, EVERY_S = 4.0, 6.0  # [s] of the first lane change, and from one to the next
LANE_AHEAD = (0.0, 25.0, 50.0)  # [m] where a lane must be for a change into it
seen = {}  # the newest message of every type, and of the table of the lanes
chosen = {"offset": 0.0, "next_s": BEGIN_S}  # [m] of the lane from the route, to the left; [s] of the next change


def on_message(message, key=None):
    seen[key or type(message)] = message
    said = seen.get(DiagnosticArray)
    if said and {"FINISHED", "FAILED"} & {value.value for status in said.status for value in status.values}:
        raise SystemExit
    latched = route, lanes, box, table = [seen.get(kind) for kind in (Path, MarkerArray, PolygonStamped, "table")]
    ego, objects = seen.get(Odometry), seen.get(PointCloud2)
    if message is said or not (all(latched) and ego and objects and ego.header.stamp == objects.header.stamp):
        return  # nothing to answer, or the inputs of the step are not complete
    del seen[PointCloud2]  # one answer each time that a step is published
    length = np.ptp([corner.x for corner in box.polygon.points])  # [m] of the ego
    route = by_metres(pose.pose.position for pose in route.poses)
    on_route, limit = points_of(table)["on_route"], points_of(table)["speed_limit"]
    publisher.publish(answer(route, centre_lines(lanes, on_route), min(limit[on_route > 0]), length, ego, objects))


def by_metres(points):
    """A line as complex numbers [m], a point for each metre."""
    corners = np.array([complex(p.x, p.y) for p in points])
    s = np.append(0.0, np.cumsum(abs(np.diff(corners))))
    return np.interp(np.arange(s[-1]), s, corners)


def points_of(cloud):
    """The points of a cloud, with its fields."""
    return np.frombuffer(cloud.data, {f.name: (" bBhHiIfd"[f.datatype], f.offset) for f in cloud.fields})


def centre_lines(lanes, on_route):
    """Points of the centre lines of the lanes on the route, as complex numbers [m]."""
    centres = [marker for marker in lanes.markers if marker.ns == "centre" and on_route[marker.id]]
    return np.concatenate([by_metres(marker.points) for marker in centres])


def answer(route, centres, limit, length, ego, objects):
    agents = points_of(objects)
    half = 0.5 * (length + agents["length"])  # [m] from centre to centre where bumpers meet
    pose, speed = ego.pose.pose, ego.twist.twist.linear.x
    at, yaw = complex(pose.position.x, pose.position.y), 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
    here = np.argmin(abs(route[:-60] - at))
    along = np.exp(1j * np.angle(route[here + 5] - route[here]))  # direction of the road
    others = (agents["x64"] + 1j * agents["y64"] - route[here]) / along
    own = (at - route[here]) / along
    ahead, left = others.real - own.real, others.imag

    def room(lane):
        """Distance [m] to the vehicle ahead in a lane, given by its distance from the route."""
        return np.min((ahead - half)[(ahead > 0.0) & (abs(left - lane) < 1.8)], initial=100.0)

    def free(lane):
        places = route[here] + along * (own.real + np.array(LANE_AHEAD) + 1j * lane)
        exists = all(np.min(abs(centres - place)) < 1.0 for place in places)
        return exists and not np.any((abs(ahead) - half < BESIDE) & (abs(left - lane) < 1.8))

    now = Time.from_msg(ego.header.stamp).nanoseconds * 1e-9
    if now >= chosen["next_s"]:
        lanes = [lane for lane in (chosen["offset"] - WIDTH, chosen["offset"] + WIDTH) if free(lane)]
        if lanes:
            chosen.update(offset=max(lanes, key=room), next_s=now + EVERY_S)
    gap = min(room(chosen["offset"]), room(own.imag)) - 2.5  # in the lane that it drives to, and in the one it is in
    look = int(max(15.0, 1.5 * speed))  # [m]
    target = route[here + look] + 1j * along * chosen["offset"]
    twist = TwistStamped(header=ego.header)  # with the stamp of the step
    twist.header.frame_id = "ego"
    twist.twist.linear.x = float(speed + np.clip(min(WANTED, limit, max(0.0, gap / HEADWAY)) - speed, -0.4, 0.1))
    twist.twist.angular.z = float(2.0 * speed / look * np.sin(np.angle(target - at) - yaw))  # pure pursuit
    return twist


rclpy.init()
node = rclpy.create_node("lane_changing_ads")
publisher = node.create_publisher(TwistStamped, "/litsim/ego/twist", 10)
latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
for kind, topic in (Odometry, "/litsim/ego/state"), (PointCloud2, "/litsim/objects"), (DiagnosticArray, "/diagnostics"):
    node.create_subscription(kind, topic, on_message, 100)
node.create_subscription(Path, "/litsim/ego/route", on_message, latched)
node.create_subscription(PolygonStamped, "/litsim/ego/footprint", on_message, latched)
node.create_subscription(MarkerArray, "/litsim/lanes", on_message, latched)
node.create_subscription(PointCloud2, "/litsim/lanes/table", lambda message: on_message(message, "table"), latched)
rclpy.spin(node)
