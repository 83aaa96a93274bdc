"""`security`: write an SROS2 policy of all publishers and subscribers, for `ros2 security generate_artifacts`.

Every program of LitSim that takes part in runs gets its own enclave, /litsim/NAME. A stack under test gets /litsim/ads,
in which it may answer on one topic of the ego port, and read the topics published for it.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import InputError
from litsim_sim.core.stages import BRIDGE, CONFLICT, EGO, POLICY, POLICY_STAGES, PREDICTOR, RECORDER
from litsim_sim.core.topic_names import Interface
from litsim_sim.io.files import replacing
from litsim_sim.launch.nodes import STAGES_PROGRAM, program_of
from litsim_sim.launch.processes import STACK

DOMAIN = "ROS_DOMAIN_ID"


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval security``."""
    p = Parser(prog="security", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--out", type=Path, required=True, metavar="POLICY.xml", help="file to write")
    stack = p.add_argument_group("a stack under test")
    stack.add_argument(
        "--ego-interface", choices=[each.value for each in Interface], help="interface on which it may answer"
    )
    stack.add_argument("--stack-node", nargs="+", default=[], metavar="NODE", help="full names of its nodes")
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Runs ``ros2 run litsim_eval security``."""
    arguments = parser().parse_args(argv)
    if bool(arguments.ego_interface) != bool(arguments.stack_node):
        raise InputError("--ego-interface and --stack-node: expected both for a stack under test, or none")
    interface = Interface(arguments.ego_interface) if arguments.ego_interface else None
    text = policy(interface, arguments.stack_node)
    with replacing(arguments.out) as made:
        made.write_text(text)
    domain = os.environ.get(DOMAIN, "0")
    print(f"{arguments.out} is written; {DOMAIN}={domain} ros2 security generate_artifacts makes keys from it")


def policy(interface: Interface | None = None, stack_nodes: Sequence[str] = ()) -> str:
    """Returns the policy as XML, with an enclave for a stack if `interface` is given, for its nodes `stack_nodes`.

    Raises:
        InputError: a name of a node is not valid.
    """
    from litsim_eval.check_ads.bystander import PROGRAM as CHECK_ADS  # ROS takes a moment to load
    from litsim_eval.check_ads.bystander import Bystander
    from litsim_policy.conflict.node import ConflictNode
    from litsim_policy.driving.node import PolicyNode
    from litsim_policy.ego.node import EgoNode
    from litsim_predictor.ros.node import PredictorNode
    from litsim_sim.nodes.bridge_node import BridgeNode
    from litsim_sim.nodes.live import NAME as LIVE
    from litsim_sim.nodes.live import LiveNode
    from litsim_sim.nodes.recorder import RecorderNode
    from litsim_sim.ros.security import policy_xml, stack_endpoints

    stages: dict[str, Any] = {
        BRIDGE: BridgeNode,
        RECORDER: RecorderNode,
        PREDICTOR: PredictorNode,
        CONFLICT: ConflictNode,
        POLICY: PolicyNode,
        EGO: EgoNode,
    }
    classes = {program_of(stage)[1]: node for stage, node in stages.items()}
    classes |= {LIVE: LiveNode, CHECK_ADS: Bystander}
    nodes = {name: [node.declared] for name, node in classes.items()}
    nodes[STAGES_PROGRAM] = [stages[stage].declared for stage in (EGO, *POLICY_STAGES)]
    if interface is not None:
        nodes[STACK] = [stack_endpoints(name, interface) for name in stack_nodes]
    return policy_xml(nodes)


if __name__ == "__main__":
    main()
