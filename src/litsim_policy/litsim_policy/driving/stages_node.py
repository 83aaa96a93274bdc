"""Predictor, conflict and policy in one process: no messages are awaited between them."""

from __future__ import annotations

from litsim_policy.conflict.node import ConflictNode
from litsim_policy.driving.node import PolicyNode
from litsim_predictor.predictor_node import PredictorNode
from litsim_sim.ros.stage import run_stages


def main() -> None:
    """Entry point of ``ros2 run litsim_policy policy_stages``."""
    run_stages(PredictorNode, ConflictNode, PolicyNode)


if __name__ == "__main__":
    main()
