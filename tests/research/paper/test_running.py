"""Campaigns are gone on with; they are begun anew only where other sources have run, and only when told to."""

from pathlib import Path

import pytest

import campaigns
from litsim_eval.campaign.suite import Suite
from litsim_research.paper import running
from litsim_research.paper.running import carried_out
from litsim_sim.core.errors import InputError


def suite(*egos: int) -> Suite:
    return campaigns.suite(cases=[{"scenario": "demo", "ego_id": list(egos)}], egos=["log"], policies=["replay"])


def test_what_has_been_run_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sources = {"python": "3", "sources": "a"}
    monkeypatch.setattr(running, "code_versions", lambda: dict(sources))
    first = carried_out(suite(7), tmp_path / "out", 1)
    (kept,) = first.results
    both = carried_out(suite(7, 3), tmp_path / "out", 1, overwrite=True)
    assert len(both.results) == 2 and kept in both.results
    with pytest.raises(InputError, match="holds more than this part of a suite"):
        carried_out(suite(7), tmp_path / "out", 1, overwrite=True)  # a part of it is no reason to lose the rest
    sources["sources"] = "b"
    with pytest.raises(InputError, match="sources a, now b"):
        carried_out(suite(7), tmp_path / "out", 1)
    (anew,) = carried_out(suite(7), tmp_path / "out", 1, overwrite=True).results
    assert anew.case.id != kept.case.id and anew.metrics["digest"] == kept.metrics["digest"]
