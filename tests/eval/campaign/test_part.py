"""Parts of a suite: what each option chooses, and the suite that is made of it."""

from pathlib import Path
from typing import Any

import pytest

from campaigns import EGOS, cases, metrics, stored
from litsim_eval.campaign.case import Case, cases_of
from litsim_eval.campaign.part import Part, suite_of_cases, write_suite
from litsim_eval.campaign.suite import Suite
from litsim_sim.core.errors import InputError

FIRST, SECOND, THIRD = EGOS[:3]
ROADS = [
    {
        "scenario": "demo",
        "ego_id": FIRST,
        "tags": ["near"],
        "events": [{"kind": "cut_in", "severity": 0.2, "ttc_s": 4}],
    },
    {"scenario": "demo", "ego_id": SECOND, "tags": ["far"], "events": [{"kind": "merge", "severity": 0.7, "ttc_s": 2}]},
    {"scenario": "demo", "ego_id": THIRD},
]


@pytest.fixture
def made() -> list[Case]:
    return cases(cases=ROADS, policies=["replay", "yield"])


@pytest.mark.parametrize(
    ("part", "egos", "policies"),
    [
        ({"names": [f"demo/{FIRST}"]}, {FIRST}, {"replay", "yield"}),
        ({"names": [f"demo/{FIRST}/idm/yield"]}, {FIRST}, {"yield"}),
        ({"names": ["*/yield"]}, {FIRST, SECOND, THIRD}, {"yield"}),
        ({"tags": ["far", "near"]}, {FIRST, SECOND}, {"replay", "yield"}),
        ({"events": ["merge"]}, {SECOND}, {"replay", "yield"}),
        ({"events": ["merge", "cut_in"], "hardest": (2, "severity")}, {SECOND}, {"replay", "yield"}),
        ({"hardest": (2, "ttc_s")}, {SECOND}, {"replay", "yield"}),
        ({"tags": ["near"], "names": ["*/replay"]}, {FIRST}, {"replay"}),
    ],
)
def test_options_choose(made: list[Case], part: dict[str, Any], egos: set[int], policies: set[str]) -> None:
    chosen = Part(**part).of(made)
    assert ({case.ego_id for case in chosen}, {case.policy for case in chosen}) == (egos, policies)


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ({"names": ["demo/99"]}, r"--case demo/99: no such case, expected names such as demo/"),
        ({"tags": ["fat"]}, "--tag fat: no case is left, expected some of far, near"),
        ({"events": ["turn"]}, "--event turn: no case is left, expected some of cut_in, merge"),
        ({"hardest": (3, "speed")}, r"--hardest 3 speed: .* one of its events \(severity, ttc_s\), or of metrics.json"),
    ],
)
def test_what_chooses_none_is_told(made: list[Case], part: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Part(**part).of(made)


def test_what_has_failed_in_a_campaign_is_found_by_name_or_else_by_vehicle(tmp_path: Path, made: list[Case]) -> None:
    asked = {"cases": ROADS, "policies": ["replay", "yield"], "seeds": []}
    campaign = stored(tmp_path, [metrics(), metrics(1), metrics(), metrics(), metrics(), "no answer"], **asked)
    names = [result.case.name for result in campaign.results if result.verdict != "passed"]
    assert [case.name for case in Part(failed_in=campaign).of(made)] == names
    others = cases(cases=ROADS, policies=["replay"], egos=["log"])
    assert {case.ego_id for case in Part(failed_in=campaign).of(others)} == {SECOND, THIRD}
    with pytest.raises(InputError, match=r"--failed-in .*: no case is left"):
        Part(names=[f"demo/{FIRST}"], failed_in=campaign).of(made)


def test_the_nearest_misses_are_those_of_this_stack(tmp_path: Path, made: list[Case]) -> None:
    times = [1.0, 3.0, None, 2.0, 0.5, 4.0]
    outcomes = [metrics(safety={"min_own_ttc_s": time}) for time in times]
    campaign = stored(tmp_path, outcomes, cases=ROADS, policies=["replay", "yield"], seeds=[])
    chosen = Part(hardest=(3, "safety.min_own_ttc_s"), measured_in=campaign).of(made)
    by_name = {result.case.name: time for result, time in zip(campaign.results, times, strict=True)}
    assert [by_name[case.name] for case in chosen] == [0.5, 1.0, 2.0]


def test_a_part_is_a_suite_of_its_own(tmp_path: Path, made: list[Case]) -> None:
    folder = tmp_path / "stacks"
    folder.mkdir()
    (folder / "mine.py").touch()
    (folder / "own.yaml").write_text(
        "name: own\negos: [{name: mine, kind: external, command: [python3, mine.py], environment: [GAIN=2]}, idm]\n"
        f"policies: [replay, yield]\ncases: [{{scenario: small/street_14.yaml, ego_id: 69}}, "
        f"{{scenario: demo, ego_id: {FIRST}, tags: [near]}}]\n"
    )
    whole = Suite.load(folder / "own.yaml")
    part = [case for case in cases_of(whole) if case.ego.name == "mine" and case.policy == "yield"]
    write_suite(suite_of_cases(whole, part), tmp_path / "part.yaml")
    written = Suite.load(tmp_path / "part.yaml")
    assert cases_of(written) == part
    text = (tmp_path / "part.yaml").read_text()
    assert "scenario: small/street_14.yaml" in text and "folder: stacks" in text and str(tmp_path) not in text
