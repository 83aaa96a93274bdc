"""SROS2 policy of all nodes: topics that each may publish and subscribe to, for keys and permissions of DDS Security.

The format is that of ``ros2 security`` (policy.xsd, version 0.2.0). Anything not allowed is denied.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence

from rclpy.exceptions import InvalidNamespaceException, InvalidNodeNameException
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name

from litsim_sim.core.errors import InputError
from litsim_sim.core.topic_names import Interface
from litsim_sim.launch.middleware import enclave_of
from litsim_sim.ros.endpoints import Endpoints
from litsim_sim.ros.topics import EGO_FEEDS, EGO_INPUTS

VERSION = "0.2.0"
OF_EVERY_NODE = ("/parameter_events", "/rosout")
"""Topics that every rclpy node publishes."""
SERVICES = (
    "~/describe_parameters",
    "~/get_parameter_types",
    "~/get_parameters",
    "~/get_type_description",
    "~/list_parameters",
    "~/set_parameters",
    "~/set_parameters_atomically",
)
"""Services that every rclpy node has; no node calls any."""
ALLOW = "ALLOW"


def stack_endpoints(node: str, interface: Interface) -> Endpoints:
    """Endpoints of node `node` of a stack under test: its answers by `interface`, and the topics for it to read."""
    try:
        namespace, name = _split(node)
        validate_namespace(namespace)
        validate_node_name(name)
    except (InvalidNamespaceException, InvalidNodeNameException) as error:
        raise InputError(f"node {node!r}: {str(error).splitlines()[0]}") from error
    return Endpoints(node, (EGO_INPUTS[interface],), EGO_FEEDS)


def policy_xml(nodes: Mapping[str, Sequence[Endpoints]]) -> str:
    """Returns the policy with one enclave per program.

    Args:
        nodes: endpoints of the nodes of each program, see :func:`litsim_sim.launch.middleware.enclave_of`.
    """
    policy = ET.Element("policy", version=VERSION)
    enclaves = ET.SubElement(policy, "enclaves")
    for program, endpoints in nodes.items():
        enclave = ET.SubElement(enclaves, "enclave", path=enclave_of(program))
        profiles = ET.SubElement(enclave, "profiles")
        for of_node in endpoints:
            _profile(profiles, of_node)
    ET.indent(policy)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(policy, encoding="unicode")}\n'


def _profile(profiles: ET.Element, endpoints: Endpoints) -> None:
    namespace, name = _split(endpoints.node)
    profile = ET.SubElement(profiles, "profile", ns=namespace, node=name)
    _rule(profile, "topics", "publish", [*OF_EVERY_NODE, *(topic.name for topic in endpoints.publishes)])
    _rule(profile, "topics", "subscribe", [topic.name for topic in endpoints.hears])
    _rule(profile, "services", "reply", SERVICES)


def _split(node: str) -> tuple[str, str]:
    """Namespace and name of a node from its full name."""
    namespace, _, name = f"/{node.removeprefix('/')}".rpartition("/")
    return namespace or "/", name


def _rule(profile: ET.Element, kind: str, verb: str, names: Iterable[str]) -> None:
    """Allow `verb` on the topics or services `names`; adds nothing for no names."""
    if ordered := sorted(set(names)):
        rule = ET.SubElement(profile, kind, {verb: ALLOW})
        for name in ordered:
            ET.SubElement(rule, kind.removesuffix("s")).text = name
