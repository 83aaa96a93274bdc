"""The command that writes the policy for DDS Security."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from command_line import refusal
from litsim_eval.cli.security import main
from litsim_sim.core.stages import BRIDGE, EGO, POLICY_STAGES, RECORDER
from litsim_sim.launch.nodes import program_of


def enclaves(path: Path) -> dict[str, list[str]]:
    """Names of the nodes in each enclave."""
    found = ET.parse(path).iterfind("enclaves/enclave")
    return {each.attrib["path"]: [p.attrib["node"] for p in each.iter("profile")] for each in found}


def test_every_program_that_takes_part_in_runs_has_an_enclave(tmp_path: Path) -> None:
    main(["--out", str(tmp_path / "policy.xml")])
    stages = {name: program_of(name)[1] for name in (BRIDGE, RECORDER, *POLICY_STAGES, EGO)}
    expected = {f"/litsim/{program}": [stage] for stage, program in stages.items()}
    expected |= {"/litsim/stages": [EGO, *POLICY_STAGES]}
    expected |= {"/litsim/live": ["live"], "/litsim/check_ads": ["litsim_check_ads"]}
    assert enclaves(tmp_path / "policy.xml") == expected


def test_all_nodes_of_a_stack_are_in_one_enclave(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "policy.xml"
    main(["--out", str(path), "--ego-interface", "trajectory", "--stack-node", "/mine/planner", "control"])
    assert enclaves(path)["/litsim/ads"] == ["planner", "control"]
    assert str(path) in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--ego-interface", "twist"], "expected both"),
        (["--stack-node", "/mine"], "expected both"),
        (["--ego-interface", "twist", "--stack-node", "/a b"], "node '/a b': Invalid node name"),
    ],
)
def test_a_stack_that_is_not_said_in_full_is_told(
    tmp_path: Path, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (line,) = refusal(capsys, main, "--out", tmp_path / "policy.xml", *words).splitlines()
    assert said in line
    assert not list(tmp_path.iterdir())
