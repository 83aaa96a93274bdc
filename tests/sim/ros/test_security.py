"""The policy for DDS Security; whether nodes keep to it is seen in tests/graph/test_security.py."""

import xml.etree.ElementTree as ET
from pathlib import Path

from litsim_sim.core.stages import BRIDGE, EGO, POLICY_STAGES, RECORDER
from litsim_sim.launch.nodes import program_of
from litsim_sim.ros.topics import EGO_FEEDS, EGO_INPUTS

POLICY = Path(__file__).resolve().parents[3] / "src/litsim_sim/config/security.xml"


def test_every_program_has_an_enclave_and_a_stack_answers_on_one_topic() -> None:
    enclaves = {enclave.attrib["path"]: list(enclave.iter("profile")) for enclave in ET.parse(POLICY).iter("enclave")}
    expected = {f"/litsim/{program_of(stage)[1]}": [stage] for stage in (BRIDGE, RECORDER, *POLICY_STAGES, EGO)}
    expected |= {"/litsim/stages": [EGO, *POLICY_STAGES], "/litsim/live": ["live"], "/litsim/ads": ["minimal_ads"]}
    expected |= {"/litsim/check_ads": ["litsim_check_ads"]}
    assert {path: [profile.attrib["node"] for profile in profiles] for path, profiles in enclaves.items()} == expected
    publish, subscribe, _ = ({name.text for name in rule} for rule in enclaves["/litsim/ads"][0])
    assert len(publish & {topic.name for topic in EGO_INPUTS.values()}) == 1
    assert subscribe == {topic.name for topic in EGO_FEEDS}
