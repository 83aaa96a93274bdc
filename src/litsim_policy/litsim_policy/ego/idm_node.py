"""Entry point of the `idm` ego."""

from __future__ import annotations

from litsim_policy.ego.node import EgoNode
from litsim_sim.ros.stage import run_node


def main() -> None:
    """Entry point of ``ros2 run litsim_policy ego_idm``."""
    run_node(lambda: EgoNode("idm"))


if __name__ == "__main__":
    main()
