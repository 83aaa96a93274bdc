"""Which case is shown: the first that replay makes a contact of the ego, and ours none."""

import shutil
from pathlib import Path
from typing import Any

import pytest

import campaigns
from litsim_data.mining.events import EventKind
from litsim_data.segments import MANIFEST_FILE
from litsim_data.traffic.seeds import LEFT_TURNS
from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.results import Campaign, RunResult
from litsim_research.paper import roads
from litsim_research.paper.case_studies import LEFT_TURN, SEGMENTS, candidates, chosen, left_turns
from litsim_sim.scenario.scenario import packaged

TURN_37, TURN_50 = ("street_37", 128), ("street_50", 160)
"""Who passes before a left turn in suite small, the nearest first."""


def campaign(metrics: dict[tuple[int, str], dict[str, Any]], **turns: list[int]) -> Campaign:
    """Results of egos of the demo, by ego and policy; `turns` are left turns of egos, as `ego_5`, across others."""
    cases = campaigns.cases(
        cases=[
            {"scenario": "demo", "ego_id": ego, "events": [_turn(other) for other in turns.get(f"ego_{ego}", [])]}
            for ego in sorted({ego for ego, _ in metrics})
        ],
        policies=["replay", "litsim"],
    )
    results = [RunResult(case, Verdict.PASSED, "", (), metrics[case.ego_id, case.policy]) for case in cases]
    return Campaign(Path(), "some", campaigns.CRITERIA, {}, tuple(cases), tuple(results), "")


def _turn(other: int) -> dict[str, Any]:
    return {"kind": "left_turn", "other": other, "time_s": 5.0}


def run(*contacts: tuple[int, int, int, bool], taken: int = 1) -> dict[str, Any]:
    """Contacts: two agents, the step, and whether the log has it."""
    told = [{"pair": [a, b], "step": step, "in_log": in_log} for a, b, step, in_log in contacts]
    return {"collision": {"contacts": told}, "reactive": all(each["in_log"] for each in told), "takeovers": taken}


def test_the_first_that_replay_fails_and_ours_resolves_is_shown() -> None:
    metrics = {
        (1, "replay"): run((2, 3, 50, False)),  # not of the ego
        (1, "litsim"): run(),
        (2, "replay"): run((2, 3, 40, True)),  # of the log
        (2, "litsim"): run(),
        (3, "replay"): run((3, 9, 60, False)),  # which ours does not resolve
        (3, "litsim"): run((3, 9, 80, False)),
        (4, "replay"): run((4, 9, 60, False)),  # nobody was taken over: not by what we do
        (4, "litsim"): run(taken=0),
        (5, "replay"): run((5, 9, 90, False), (5, 8, 70, False)),
        (5, "litsim"): run(),
        (7, "replay"): run((7, 9, 10, False)),
        (7, "litsim"): run(),
    }
    study = chosen(campaign(metrics))
    assert study is not None
    assert (study.replay.ego_id, study.replay.policy, study.ours.policy, study.contact) == (5, "replay", "litsim", 70)
    assert chosen(campaign({key: metrics[key] for key in metrics if key[0] < 5})) is None


def test_a_left_turn_is_shown_whose_paths_cross() -> None:
    metrics = {
        (1, "replay"): run((1, 8, 50, False), (1, 9, 70, False)),  # run into from behind, before the turn
        (2, "replay"): run((2, 9, 60, False)),  # which is the other of a crossing, not of a turn
        (3, "replay"): run((3, 9, 60, True), (3, 7, 80, False)),  # which the log has
        (4, "replay"): run((4, 8, 90, False), (4, 9, 55, False)),
        (5, "replay"): run((5, 9, 40, False)),
    }
    metrics |= {(ego, "litsim"): run() for ego, _ in metrics}
    crossed = {"ego_1": [9], "ego_3": [9], "ego_4": [3, 9], "ego_5": [9]}
    study = chosen(campaign(metrics, **crossed), EventKind.LEFT_TURN)
    assert study is not None and (study.ours.ego_id, study.contact) == (4, 55)
    assert (
        chosen(campaign({key: metrics[key] for key in metrics if key[0] < 4}, **crossed), EventKind.LEFT_TURN) is None
    )


def test_candidates_of_the_street_pass_before_the_other_turns(tmp_path: Path) -> None:
    """Of the turns in suite small those whose other goes second, and with any ego the nearest first."""
    suite = candidates(LEFT_TURN, tmp_path, quick=True)
    assert [(Path(case.scenario).stem, case.ego_id) for case in suite.cases] == [TURN_37, TURN_50]
    assert [ego.name for ego in suite.egos] == ["braker", "idm", "hard_braker"]
    backwards = left_turns([case.scenario for case in reversed(suite.cases)])
    assert backwards == suite.cases
    for case in backwards:
        (event,) = case.events
        assert (event["kind"], event["first"], event["role"]) == (EventKind.LEFT_TURN, "ego", "oncoming")


def test_the_street_is_of_a_seed_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is there already is read, not generated again."""
    made: list[tuple[str, int, int]] = []

    def written(net: str, count: int, seed: int, folder: Path) -> None:
        made.append((net, count, seed))
        folder.mkdir(parents=True)
        (folder / MANIFEST_FILE).touch()
        for name, _ in (TURN_37, TURN_50):
            for file in packaged("suites/small", "litsim_eval").glob(f"{name}.*"):
                shutil.copy(file, folder)

    monkeypatch.setattr(roads, "write_segment_set", written)
    first, again = (candidates(LEFT_TURN, tmp_path, quick=False) for _ in range(2))
    assert made == [("urban_like", SEGMENTS, LEFT_TURNS)]
    assert first == again
    assert [(Path(case.scenario).stem, case.ego_id) for case in first.cases] == [TURN_37, TURN_50]
    assert all(Path(case.scenario).is_relative_to(tmp_path) for case in first.cases)
