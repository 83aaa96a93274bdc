"""Sentences on the background of a campaign, from made results of `credibility`."""

from typing import Any

import pytest

from campaigns import cases
from litsim_eval.campaign import background
from litsim_eval.campaign.background import background_sentences


def figures(encounters: int, own: float, people: float, **more: Any) -> dict[str, Any]:
    return {"encounters": encounters, "least_gap_m": own, "least_gap_people_m": people, **more}


@pytest.fixture(autouse=True)
def results(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = {"cut_in": figures(30, 2.0, 5.0), "leader_brakes": figures(70, 1.0, 7.0)}
    made = figures(100, 1.5, 6.5, policy="litsim", parameters={}, kinds=kinds)
    monkeypatch.setattr(background, "_packaged", lambda: [made])


def said(**values: Any) -> list[str]:
    return background_sentences(cases(**values))


def test_the_distance_in_all_encounters_stands_beside_peoples() -> None:
    (sentence,) = said(policies=["litsim", "replay"])
    assert sentence.startswith(
        "In 100 encounters of recorded traffic, background litsim kept 1.5 m where people kept 6.5"
    )


def test_encounters_are_those_of_the_kinds_of_the_cases_events() -> None:
    entry = {"scenario": "demo", "ego_id": "ego", "events": [{"kind": "cut_in"}, {"kind": "turn"}]}
    (sentence,) = said(policies=["litsim"], cases=[entry])
    assert sentence.startswith("In 30 encounters like those of this campaign (cut in), background litsim kept 2.0 m")


def test_a_background_with_other_parameters_was_not_measured() -> None:
    first, second = said(policies=["litsim"], parameters={"conflict.horizon": [2.0, 3.0]})
    assert all("was not measured" in each for each in (first, second)) and "horizon=2.0" in first


def test_drawn_drivers_and_the_median_one_are_packaged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    for drivers in (1, 2):
        assert "was not measured" not in said(policies=["litsim"], drivers=drivers)[0]
