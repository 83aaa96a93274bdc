"""`compare` of two campaigns: what it prints, its exit status, what it refuses."""

import json
from pathlib import Path
from typing import Any

import pytest

from campaigns import EGO, metrics, stored
from command_line import refusal, status
from litsim_eval.cli.compare import main
from litsim_sim.scenario.scenario import Scenario


def by_faults(folder: Path, at_fault: list[int], asked: dict[str, Any] | None = None, **values: float) -> str:
    """A campaign with a run for each of `at_fault`; `values` of its measures grow by 1 from run to run."""
    changes = [{name: value + k for name, value in values.items()} for k in range(len(at_fault))]
    outcomes = [metrics(at_fault=hits, **more) for hits, more in zip(at_fault, changes, strict=True)]
    return str(stored(folder, outcomes, **(asked or {})).folder)


VEHICLES = Scenario.load("demo").possible_egos


def by_vehicle(count: int) -> dict[str, Any]:
    """A suite of `count` vehicles, with one run each."""
    return {"seeds": [], "cases": [{"scenario": "demo", "ego_id": list(VEHICLES[:count])}]}


def test_a_newly_failing_case_is_status_1_with_both_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = by_faults(tmp_path / "a", [0, 1, 0]), by_faults(tmp_path / "b", [0, 0, 1])
    assert status(main, before, after) == 1
    out = capsys.readouterr().out
    assert f"1 of 3 newly failing\n  demo/{EGO}/idm/litsim/2\n    was passed\n" in out
    assert "    is failed\n      no contact at fault: collision.ego_at_fault is 1, expected at most 0\n" in out
    assert f"1 of 3 newly passing\n  demo/{EGO}/idm/litsim/1\n" in out
    for folder in (before, after):
        assert sum(line.strip().startswith(f"{folder}/runs/") for line in out.splitlines()) == 2
        assert f"{folder}/runs/" in out and "report.html" in out


def test_better_or_equal_is_status_0(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = by_faults(tmp_path / "a", [0, 1]), by_faults(tmp_path / "b", [0, 0])
    main([before, after])
    assert "0 of 2 newly failing" in capsys.readouterr().out
    main([after, after])
    assert "0 of 2 newly passing" in capsys.readouterr().out


def test_names_of_measures_stay_whole_at_100_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = "comfort.ego.within.longitudinal_acceleration"
    folders = []
    for at, value in (("a", -1.23456e-5), ("b", 1.23456e-5)):
        within = [{"longitudinal_acceleration": value * (1 + number)} for number in range(2)]
        outcomes = [metrics(comfort={"ego": {"within": each}}) for each in within]
        folders.append(str(stored(tmp_path / at, outcomes, **by_vehicle(2)).folder))
    main(folders)
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if name in line)
    assert "-1.9e-05 1.9e-05 +3.7e-05" in row and len(row) <= 100


def test_json_has_everything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = by_faults(tmp_path / "a", [0]), by_faults(tmp_path / "b", [0])
    main([before, after, "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["common"] == 1 and found["newly_failing"] == []
    assert found["measures"][0]["name"] == "passed"
    assert "collision.ego_at_fault" in [each["name"] for each in found["measures"]]


@pytest.mark.parametrize(("others", "said"), [(["none"], "none: no folder of a campaign"), (["a", "a"], "3 campaigns")])
def test_what_is_no_pair_of_campaigns_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], others: list[str], said: str
) -> None:
    before = by_faults(tmp_path / "a", [0])
    assert said in refusal(capsys, main, before, *(str(tmp_path / other) for other in others))


def test_enough_vehicles_are_not_called_few(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, repeated = by_faults(tmp_path / "a", [0] * 20, by_vehicle(20)), by_faults(tmp_path / "b", [0] * 20)
    main([folder, folder])
    assert "too narrow" not in capsys.readouterr().out
    main([repeated, repeated])
    assert "too narrow" in capsys.readouterr().out, "20 seeds of one vehicle are few"


def test_a_campaign_alone_is_compared_with_what_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = by_faults(tmp_path / "a", [0, 0])
    assert "nothing has changed in this campaign yet" in refusal(capsys, main, folder)
    stored(tmp_path / "a", [metrics(0), metrics(1)], sources="c")
    assert status(main, folder) == 1
    assert f"1 of 2 newly failing\n  demo/{EGO}/idm/litsim/1\n" in capsys.readouterr().out
