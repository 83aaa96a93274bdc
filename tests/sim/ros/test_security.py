"""What a policy for DDS Security says, as XML; whether nodes keep to it is seen in tests/graph/test_security.py."""

import xml.etree.ElementTree as ET

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.core.topic_names import Interface
from litsim_sim.ros.endpoints import Endpoints
from litsim_sim.ros.security import OF_EVERY_NODE, SERVICES, policy_xml, stack_endpoints
from litsim_sim.ros.topics import AGENTS, CONTROLS, EGO_INPUTS, HELLO


def rules(profile: ET.Element) -> dict[tuple[str, str, str], list[str | None]]:
    """Names by tag, verb and word of each rule."""
    return {(rule.tag, *next(iter(rule.attrib.items()))): [each.text for each in rule] for rule in profile}


def test_each_program_has_an_enclave_with_what_its_nodes_publish_and_hear() -> None:
    given = {
        "one": [Endpoints("node", (HELLO, AGENTS), (CONTROLS, CONTROLS))],
        "two": [Endpoints("/space/deaf", (), ()), Endpoints("other", (), (HELLO,))],
    }
    text = policy_xml(given)
    assert text.startswith('<?xml version="1.0" encoding="UTF-8"?>')
    root = ET.fromstring(text)
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    assert [each.attrib["path"] for each in root.iterfind("enclaves/enclave")] == ["/litsim/one", "/litsim/two"]
    one, deaf, other = root.iterfind("enclaves/enclave/profiles/profile")
    assert [each.attrib for each in (one, deaf)] == [{"ns": "/", "node": "node"}, {"ns": "/space", "node": "deaf"}]
    services = {("services", "reply", "ALLOW"): list(SERVICES)}
    assert rules(one) == {
        ("topics", "publish", "ALLOW"): ["/litsim/agents", "/litsim/hello", *OF_EVERY_NODE],
        ("topics", "subscribe", "ALLOW"): ["/litsim/controls"],
        **services,
    }
    assert rules(deaf) == {("topics", "publish", "ALLOW"): list(OF_EVERY_NODE), **services}
    assert rules(other)["topics", "subscribe", "ALLOW"] == ["/litsim/hello"]


@pytest.mark.parametrize("interface", list(Interface))
def test_a_stack_answers_on_one_topic_and_says_nothing_else(interface: Interface) -> None:
    may = stack_endpoints("/mine", interface)
    assert may.publishes == (EGO_INPUTS[interface],)
    assert not {topic.name for topic in may.hears} & {"/litsim/controls", "/litsim/takeovers", "/litsim/forecasts"}


@pytest.mark.parametrize("name", ["", "/a b", "/1a", "a/", "/x/*"])
def test_what_is_no_name_of_a_node_is_told(name: str) -> None:
    with pytest.raises(InputError, match=r"^node '.*': Invalid n"):
        stack_endpoints(name, Interface.TWIST)
