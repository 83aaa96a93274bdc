"""A graph and a stack that stay up: with which stack a run is made."""

from pathlib import Path
from types import SimpleNamespace

import pytest

import campaigns
from litsim_eval.runs.warm_graph import WarmGraph

COMMAND = ["my_stack"]
EGO = {"name": "mine", "kind": "external", "command": COMMAND}
(CASE,) = campaigns.cases(egos=[EGO], cases=[{"scenario": "demo", "ego_id": 7}], policies=["replay"])


@pytest.mark.parametrize(
    ("of", "running", "attempts"),
    [(COMMAND, True, ["fails", ""]), (COMMAND, False, ["fails"]), (["another"], True, ["fails"])],
)
def test_a_failure_with_a_stack_that_has_driven_before_is_tried_with_a_new_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, of: list[str], running: bool, attempts: list[str]
) -> None:
    graph, outcomes = WarmGraph(), iter(attempts)
    monkeypatch.setattr(graph, "_command", of)
    monkeypatch.setattr(graph, "_stack", SimpleNamespace(running=running))
    monkeypatch.setattr(graph, "_attempt", lambda *_: next(outcomes))
    assert graph.run(CASE, tmp_path) == attempts[-1]
    assert not list(outcomes)
