"""Publishers on the inputs of the ego port that the bridge cannot hear."""

from types import SimpleNamespace

import pytest
from rclpy.qos import ReliabilityPolicy

from litsim_sim.nodes.bridge_node import unheard
from litsim_sim.ros.topics import EGO_TWIST

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
TWIST = "geometry_msgs/msg/TwistStamped"


@pytest.mark.parametrize(
    ("topic_type", "reliability", "why"),
    [
        (TWIST, RELIABLE, ""),
        (TWIST, BEST_EFFORT, "is BEST_EFFORT and cannot be heard, expected RELIABLE"),
        ("nav_msgs/msg/Path", RELIABLE, f"has type nav_msgs/msg/Path and cannot be heard, expected {TWIST}"),
    ],
)
def test_type_and_reliability_are_those_that_the_port_asks_for(
    topic_type: str, reliability: ReliabilityPolicy, why: str
) -> None:
    info = SimpleNamespace(topic_type=topic_type, qos_profile=SimpleNamespace(reliability=reliability))
    assert unheard(EGO_TWIST, info) == why
