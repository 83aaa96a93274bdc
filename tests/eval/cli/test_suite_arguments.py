"""The suite that the options of `evaluate` make: alone, and over a file."""

import argparse
from pathlib import Path
from typing import Any

import pytest
import yaml

from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.suite import Suite
from litsim_eval.cli.suite_arguments import add_suite_arguments, suite_of
from litsim_sim.core.errors import InputError

FILE: dict[str, Any] = {
    "name": "mine",
    "cases": [{"scenario": "demo", "ego_id": 3, "tags": ["slow"]}, {"scenario": "demo", "ego_id": [7, 24]}],
    "egos": ["idm", {"name": "braker", "kind": "perturbed", "parameters": {"ego.kind": "brake"}}],
    "policies": ["litsim"],
    "seeds": [1, 2],
    "parameters": {"conflict.horizon": [2.0, 3.0]},
    "criteria": {"runs": [{"name": "no fault", "field": "collision.ego_at_fault", "max": 0}]},
}


def suite(*words: object) -> Suite:
    p = argparse.ArgumentParser()
    add_suite_arguments(p)
    return suite_of(p.parse_args([str(word) for word in words]))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(FILE))
    return path


def test_without_any_it_is_the_demo_by_the_usual_ego() -> None:
    found = suite()
    assert (found.name, [entry.scenario for entry in found.cases]) == ("demo", ["demo"])
    assert [ego.name for ego in found.egos] == ["idm"] and found.policies == ["replay", "litsim"]
    assert found.end_after_contact_s is None
    assert not found.seeds and not found.parameters and found.criteria == Criteria.load()


def test_options_are_its_fields(tmp_path: Path) -> None:
    words = ["--scenario", "demo", tmp_path / "b.yaml", "--ego-id", "7,3", "--ego", "log", "bat", "--policy", "yield"]
    words += ["--seeds", 1, 2, "--predictor", "kinematic", "--set", "conflict.horizon=2,3"]
    words += ["--end-after-contact", 1.5]
    found = suite(*words)
    assert [(entry.scenario, entry.ego_id) for entry in found.cases] == [
        ("demo", [7, 3]),
        (str(tmp_path / "b.yaml"), [7, 3]),
    ]
    assert [(ego.name, ego.kind) for ego in found.egos] == [("log", "log"), ("bat", "bat")]
    assert (found.policies, found.seeds, found.name) == (["yield"], [1, 2], "2 scenarios")
    assert found.end_after_contact_s == 1.5
    assert found.parameters == {"predictor.model": ["kinematic"], "conflict.horizon": [2, 3]}


@pytest.mark.parametrize("ids", [["7,3"], ["7", "3"], ["7,", "3"], ["7", ",3"]])
def test_ids_of_egos_may_have_spaces_between_them_before_the_command_of_a_stack(ids: list[str]) -> None:
    found = suite("--ego-id", *ids, "--ego", "external", "--", "my_stack")
    assert [entry.ego_id for entry in found.cases] == [[7, 3]]
    assert [ego.command for ego in found.egos] == [["my_stack"]]


@pytest.mark.parametrize("words", [["7", "x"], ["all", "7"], [","], ["1.5"], ["\u0667"]])
def test_what_names_no_egos_is_told(words: list[str], capsys) -> None:
    with pytest.raises(SystemExit):
        suite("--ego-id", *words)
    assert f"--ego-id: {' '.join(words)}: expected egos, tuning, ego, all, or ids" in capsys.readouterr().err


def test_a_file_is_taken_as_it_is(file: Path) -> None:
    assert suite("--suite", file) == Suite.load(file)


def test_options_take_the_place_of_its_fields(file: Path, tmp_path: Path) -> None:
    criteria = tmp_path / "criteria.yaml"
    criteria.write_text(yaml.safe_dump({"runs": [{"name": "valid", "field": "valid", "equals": True}]}))
    words = ["--ego-id", "ego", "--ego", "braker", "--policy", "replay", "--seeds", 9, "--criteria", criteria]
    found = suite("--suite", file, *words, "--set", "conflict.horizon=4.0", "policy.yield.headway=2.0")
    assert [(entry.ego_id, entry.tags) for entry in found.cases] == [("ego", ["slow"]), ("ego", [])]
    (ego,) = found.egos
    assert (ego.kind, ego.parameters) == ("perturbed", {"ego.kind": "brake"}), "of the suite, by its name"
    assert (found.policies, found.seeds, found.name) == (["replay"], [9], "mine")
    assert found.parameters == {"conflict.horizon": [4.0], "policy.yield.headway": [2.0]}
    assert [criterion.name for criterion in found.criteria.runs] == ["valid"]


def test_another_scenario_takes_the_place_of_all_cases(file: Path) -> None:
    (entry,) = suite("--suite", file, "--scenario", "demo").cases
    assert (entry.ego_id, entry.tags) == ("egos", [])


def test_a_command_starts_the_external_ego() -> None:
    found = suite("--ego", "idm", "external", "--set", "conflict.horizon=2", "--", "python3", "ads.py", "--fast")
    assert [(ego.name, ego.command) for ego in found.egos] == [
        ("idm", []),
        ("external", ["python3", "ads.py", "--fast"]),
    ]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--ego", "drunk"],
            "--ego drunk; expected autoware, autoware_universe, bat, external, idm, log, onnx, perturbed, track",
        ),
        (["--ego", "bta"], "--ego bta (near: bat)"),
        (["--ego", "idm", "--", "my_stack", "-x"], "my_stack -x: external egos: none; expected one"),
        (["--ego", "idm", "idm"], "idm more than once"),
        (["--scenario", "demo", "--seeds", "-1"], "seeds"),
        (["--suite", "nowhere"], "nowhere: no such suite, expected a YAML file"),
        (["--criteria", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_what_does_not_fit_is_an_input_error(words: list[str], said: str) -> None:
    with pytest.raises(InputError) as error:
        suite(*words)
    assert said in str(error.value)


def test_two_stacks_that_run_already_cannot_be_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    both = [{"name": name, "kind": "external"} for name in ("a", "b")]
    path.write_text(yaml.safe_dump(FILE | {"egos": both}))
    with pytest.raises(InputError, match="a, b: external egos without a command"):
        suite("--suite", path)
    assert [ego.name for ego in suite("--suite", path, "--ego", "b").egos] == ["b"]
