"""Names, types and QoS against Autoware's interface specifications.

The table is made from common/autoware_component_interface_specs/include/autoware/component_interface_specs/*.hpp of
autoware_core at 2d693b8: control, localization, perception, planning, system, vehicle. All are reliable with depth 1.
"""

import pytest

pytest.importorskip("autoware_adapi_v1_msgs", reason="Autoware's messages are not built (tools/interfaces.sh)")

import rclpy
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from litsim_autoware.stack.profile import Profile

PUBLISHED = {
    "/localization/initialization_state": ("autoware_adapi_v1_msgs/msg/LocalizationInitializationState", True),
    "/localization/kinematic_state": ("nav_msgs/msg/Odometry", False),
    "/localization/acceleration": ("geometry_msgs/msg/AccelWithCovarianceStamped", False),
    "/perception/object_recognition/objects": ("autoware_perception_msgs/msg/PredictedObjects", False),
    "/perception/traffic_light_recognition/traffic_signals": (
        "autoware_perception_msgs/msg/TrafficLightGroupArray",
        False,
    ),
    "/system/operation_mode/state": ("autoware_adapi_v1_msgs/msg/OperationModeState", True),
    "/vehicle/status/velocity_status": ("autoware_vehicle_msgs/msg/VelocityReport", False),
    "/vehicle/status/steering_status": ("autoware_vehicle_msgs/msg/SteeringReport", False),
    "/vehicle/status/gear_status": ("autoware_vehicle_msgs/msg/GearReport", False),
    "/vehicle/status/turn_indicators_status": ("autoware_vehicle_msgs/msg/TurnIndicatorsReport", False),
    "/vehicle/status/hazard_lights_status": ("autoware_vehicle_msgs/msg/HazardLightsReport", False),
    "/vehicle/status/control_mode": ("autoware_vehicle_msgs/msg/ControlModeReport", False),
}
"""Type and whether it is transient local, by the name of the topic."""
HEARD = {
    "/control/command/control_cmd": ("autoware_control_msgs/msg/Control", False),
    "/control/command/gear_cmd": ("autoware_vehicle_msgs/msg/GearCommand", False),
    "/control/command/turn_indicators_cmd": ("autoware_vehicle_msgs/msg/TurnIndicatorsCommand", False),
    "/control/command/hazard_lights_cmd": ("autoware_vehicle_msgs/msg/HazardLightsCommand", False),
    "/system/fail_safe/mrm_state": ("autoware_adapi_v1_msgs/msg/MrmState", False),
}
TRACKED = {"/perception/object_recognition/tracking/objects": ("autoware_perception_msgs/msg/TrackedObjects", False)}


@pytest.mark.parametrize(
    ("name", "published", "heard"),
    [
        ("core", PUBLISHED, HEARD),
        ("universe", TRACKED, {"/control/command/control_cmd": HEARD["/control/command/control_cmd"]}),
        ("core by trajectory", {}, {"/planning/trajectory": ("autoware_planning_msgs/msg/Trajectory", False)}),
    ],
)
def test_names_types_and_qos(name: str, published: dict[str, tuple], heard: dict[str, tuple]) -> None:
    from litsim_autoware.node.node import AutowareNode

    profile = Profile.load(name.split(maxsplit=1)[0])
    if "trajectory" in name:
        profile = profile.model_copy(update={"answers": "trajectory"})
    rclpy.init()
    try:
        node = AutowareNode(profile)
        ends = {topic: node.get_publishers_info_by_topic(topic) for topic in published}
        ends |= {topic: node.get_subscriptions_info_by_topic(topic) for topic in heard}
        for topic, (kind, latched) in (published | heard).items():
            (end,) = ends[topic]
            assert end.topic_type == kind
            assert end.qos_profile.reliability == ReliabilityPolicy.RELIABLE
            durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
            assert end.qos_profile.durability == durability
        services = dict(node.get_service_names_and_types_by_node("litsim_autoware", "/"))
        assert services["/control/control_mode_request"] == ["autoware_vehicle_msgs/srv/ControlModeCommand"]
        node.destroy_node()
    finally:
        rclpy.shutdown()
