"""How credible the background of a campaign is: what it did in encounters like those of the campaign."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from litsim_eval.campaign.case import Case
from litsim_sim.core.installation import command
from litsim_sim.core.parameters import Parameters, by_place
from litsim_sim.scenario.policies import REPLAY
from litsim_sim.scenario.run_info import plain_values
from litsim_sim.scenario.scenario import packaged

LIKE = {
    "cut_in": "cut_in",
    "hard_braking": "leader_brakes",
    "leader_braking": "leader_brakes",
    "stop_and_go": "leader_brakes",
    "merge": "merge",
    "crossing": "crossing",
    "left_turn": "turning",
    "right_turn": "turning",
}
"""Kinds of encounters by the kinds of a campaign's events, see docs/mining.md."""
PACKAGED = ("credibility", "credibility_drawn")
MORE = "docs/credibility.md"


def background_sentences(cases: Iterable[Case]) -> list[str]:
    """Returns sentences on each background of `cases`: the distance that it kept in encounters like theirs.

    The figures are those of the packaged results. Encounters are alike by the kinds of the cases' events; where none
    is, all of them count. A background that was not measured is named; replay, which never reacts, is left out.
    """
    backgrounds: dict[str, tuple[Case, set[str]]] = {}
    for case in cases:
        if case.policy != REPLAY:
            name = ", ".join(part for part in (case.policy, case.label) if part)
            kinds = {LIKE[event["kind"]] for event in case.events if event["kind"] in LIKE}
            backgrounds.setdefault(name, (case, set()))[1].update(kinds)
    return [text for name, (case, kinds) in backgrounds.items() for text in _sentences(name, case, kinds)]


def _sentences(name: str, case: Case, kinds: Collection[str]) -> Iterator[str]:
    """Yields sentences on the background called `name`, that of `case`, one for each of the `kinds` of encounters."""
    figures = _figures(case.policy, by_place(case.parameters))
    if figures is None:
        yield f"How credible background {name} is was not measured: `{command()} credibility` does ({MORE})."
        return
    alike = {f"like those of this campaign ({kind.replace('_', ' ')})": kind for kind in sorted(kinds)}
    parts = {text: figures["kinds"][kind] for text, kind in alike.items() if kind in figures["kinds"]}
    for text, own in (parts or {"of recorded traffic": figures}).items():
        yield (
            f"In {own['encounters']} encounters {text}, background {name} kept {own['least_gap_m']:.1f} m where people "
            f"kept {own['least_gap_people_m']:.1f} m, by the median of the least distance ({MORE})."
        )


def _figures(policy: str, parameters: Parameters) -> Mapping[str, Any] | None:
    """Returns the packaged measures of a policy with these parameters; None if it was not measured."""
    asked = {"policy": policy, "parameters": plain_values(parameters)}
    for figures in _packaged():
        if {"policy": figures["policy"], "parameters": plain_values(figures["parameters"])} == asked:
            return figures
    return None


@cache
def _packaged() -> Sequence[Mapping[str, Any]]:
    """Returns the measures of policies in the packaged results of `credibility`, one driver each and drawn ones."""
    texts = [packaged(f"credibility/{name}.json", "litsim_eval").read_text(encoding="utf-8") for name in PACKAGED]
    return [figures for text in texts for figures in json.loads(text)["policies"].values()]
