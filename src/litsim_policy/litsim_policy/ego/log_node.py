"""Entry point of the `log` ego."""

from __future__ import annotations

from litsim_policy.ego.node import EgoNode
from litsim_sim.ros.stage import run_node


def main() -> None:
    """Entry point of ``ros2 run litsim_policy ego_log``."""
    run_node(lambda: EgoNode("log"))


if __name__ == "__main__":
    main()
