"""Entry point of the `bat` ego."""

from __future__ import annotations

from litsim_policy.ego.node import EgoNode
from litsim_sim.ros.stage import run_node


def main() -> None:
    """Entry point of ``ros2 run litsim_policy ego_bat``."""
    run_node(lambda: EgoNode("bat"))


if __name__ == "__main__":
    main()
