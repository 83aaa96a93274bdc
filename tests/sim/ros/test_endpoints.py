"""Endpoints of the graph."""

from types import SimpleNamespace

import pytest

from litsim_sim.ros.endpoints import node_of


@pytest.mark.parametrize(
    ("namespace", "name", "full"),
    [
        ("/", "planner", "/planner"),
        ("/stack", "planner", "/stack/planner"),
        ("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_", ""),  # as rmw_dds_common gives it
    ],
)
def test_the_node_of_an_endpoint_is_named_if_it_is_known(namespace: str, name: str, full: str) -> None:
    assert node_of(SimpleNamespace(node_namespace=namespace, node_name=name)) == full
