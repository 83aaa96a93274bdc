"""Topics of a stack that are recorded beside those of LitSim: of any type whose package is installed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from litsim_sim.record.bag import BagTopic, BagWriter, qos_yaml
from litsim_sim.ros.definitions import definition, message_class, type_hash

LOOK_S = 0.5  # [s] between two looks for publishers
QUEUE = 100  # [messages]


class ForeignTopics:
    """Subscribes a node to topics as soon as they have a publisher, and hands on their messages as they are."""

    def __init__(self, node: Node, writer: BagWriter, names: Sequence[str], take: Callable[[str, bytes], None]) -> None:
        """Look for the topics `names` whenever :meth:`look` is called, every :data:`LOOK_S`.

        Their serialised messages go to `take`, with the topic.
        """
        self._node, self._writer, self._take = node, writer, take
        self._left = set(names)

    def look(self) -> None:
        """Subscribe to those topics that have got a publisher."""
        for name, types in self._node.get_topic_names_and_types():
            if name in self._left:
                self._left.discard(name)
                self._subscribe(name, types[0])

    def _subscribe(self, name: str, type_name: str) -> None:
        try:
            message_type = message_class(type_name)
        except (ImportError, AttributeError):
            self._node.get_logger().warning(f"{name} is not recorded: {type_name} is not installed")
            return
        profiles = [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)]
        reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
        latched = bool(profiles) and all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
        qos = QoSProfile(
            depth=QUEUE,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        offered = qos_yaml(QUEUE, durability="transient_local" if latched else "volatile")
        self._writer.add_topic(BagTopic(name, type_name, definition(type_name), offered, type_hash(type_name)))
        self._node.create_subscription(message_type, name, lambda data: self._take(name, data), qos, raw=True)
