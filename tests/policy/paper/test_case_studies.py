"""Which case is shown: the first that replay makes a contact of the ego, and ours none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import shapely

import campaigns
from litsim_policy.paper.case_studies import LEFT_TURN, _outlines, candidates, chosen
from litsim_sim.campaign.criteria import Verdict
from litsim_sim.campaign.results import Campaign, RunResult
from litsim_sim.mining.events import EventKind


def campaign(found: dict[tuple[int, str], dict[str, Any]], **turns: list[int]) -> Campaign:
    """Results of egos of the demo, by ego and policy; `turns` are left turns of egos, as `ego_5`, across others."""
    cases = campaigns.cases(
        cases=[
            {"scenario": "demo", "ego_id": ego, "events": [_turn(other) for other in turns.get(f"ego_{ego}", [])]}
            for ego in sorted({ego for ego, _ in found})
        ],
        policies=["replay", "litsim"],
    )
    results = [RunResult(case, Verdict.PASSED, "", (), found[case.ego_id, case.policy]) for case in cases]
    return Campaign(Path(), "some", campaigns.CRITERIA, {}, tuple(cases), tuple(results), "")


def _turn(other: int) -> dict[str, Any]:
    return {"kind": "left_turn", "other": other, "time_s": 5.0}


def run(*contacts: tuple[int, int, int, bool], taken: int = 1) -> dict[str, Any]:
    """Contacts: two agents, the step, and whether the log has it."""
    told = [{"pair": [a, b], "step": step, "in_log": in_log} for a, b, step, in_log in contacts]
    return {"collision": {"contacts": told}, "reactive": all(each["in_log"] for each in told), "takeovers": taken}


def test_the_first_that_replay_fails_and_ours_resolves_is_shown() -> None:
    found = {
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
    study = chosen(campaign(found))
    assert study is not None
    assert (study.replay.ego_id, study.replay.policy, study.ours.policy, study.contact) == (5, "replay", "litsim", 70)
    assert chosen(campaign({key: found[key] for key in found if key[0] < 5})) is None


def test_a_left_turn_is_shown_whose_paths_cross() -> None:
    found = {
        (1, "replay"): run((1, 8, 50, False), (1, 9, 70, False)),  # run into from behind, before the turn
        (2, "replay"): run((2, 9, 60, False)),  # which is the other of a crossing, not of a turn
        (3, "replay"): run((3, 9, 60, True), (3, 7, 80, False)),  # which the log has
        (4, "replay"): run((4, 8, 90, False), (4, 9, 55, False)),
        (5, "replay"): run((5, 9, 40, False)),
    }
    found |= {(ego, "litsim"): run() for ego, _ in found}
    crossed = {"ego_1": [9], "ego_3": [9], "ego_4": [3, 9], "ego_5": [9]}
    study = chosen(campaign(found, **crossed), EventKind.LEFT_TURN)
    assert study is not None and (study.ours.ego_id, study.contact) == (4, 55)
    assert chosen(campaign({key: found[key] for key in found if key[0] < 4}, **crossed), EventKind.LEFT_TURN) is None


def test_candidates_of_the_street_are_left_turns(tmp_path: Path) -> None:
    (suite,) = candidates(tmp_path, real=False, quick=True).values()
    assert len(suite.cases) == 2 and all(LEFT_TURN in case.tags for case in suite.cases)


def test_a_lane_is_drawn_as_far_as_it_is_seen() -> None:
    (outline,) = _outlines(np.array([[-100.0, 0.0], [100.0, 0.0]]), 3.0, shapely.box(-20.0, -10.0, 20.0, 10.0))
    assert np.abs(outline[:, 0]).max() == 20.0
    assert np.isclose(np.abs(outline[:, 1]).max(), 1.44)
    assert _outlines(np.array([[-100.0, 50.0], [100.0, 50.0]]), 3.0, shapely.box(-20.0, -10.0, 20.0, 10.0)) == []
