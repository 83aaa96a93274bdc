"""Entry point of the `perturbed` ego."""

from __future__ import annotations

from litsim_policy.ego.node import EgoNode
from litsim_sim.ros.stage import run_node


def main() -> None:
    """Entry point of ``ros2 run litsim_policy ego_perturbed``."""
    run_node(lambda: EgoNode("perturbed"))


if __name__ == "__main__":
    main()
