"""Several stages in one process: no messages are awaited between them."""

from __future__ import annotations

import sys
from collections.abc import Callable

from rclpy.utilities import remove_ros_args

from litsim_policy.conflict.node import ConflictNode
from litsim_policy.driving.node import PolicyNode
from litsim_policy.ego.node import EgoNode
from litsim_predictor.ros.node import PredictorNode
from litsim_sim.core.stages import CONFLICT, EGO, POLICY, PREDICTOR
from litsim_sim.ros.stage import StageNode, run_stages

STAGES: dict[str, Callable[..., StageNode]] = {
    EGO: EgoNode,
    PREDICTOR: PredictorNode,
    CONFLICT: ConflictNode,
    POLICY: PolicyNode,
}
"""What makes each stage, in the order in which they answer."""


def main() -> None:
    """Entry point of ``ros2 run litsim_policy stages STAGE...``."""
    chosen = remove_ros_args(sys.argv)[1:]
    run_stages(*(make for name, make in STAGES.items() if name in chosen), arguments=tuple(STAGES))
