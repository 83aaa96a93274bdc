"""Cases that a process runs in one go: which of them, and what comes of each."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import campaigns
from litsim_eval.report.thumbnails import read_thumbnail
from litsim_eval.runs import batched
from litsim_eval.runs.batched import BATCH_MAX, batches, record_batch, run_batch
from litsim_eval.runs.case_run import run_in_process

ROADS = [{"scenario": "demo", "ego_id": [7, 3]}]


def made(**suite: Any) -> list[Any]:
    return campaigns.cases(**({"cases": ROADS, "egos": ["log", "idm"], "policies": ["replay"]} | suite))


def test_portions_hold_what_can_be_stepped_together_and_leave_something_for_every_process() -> None:
    cases = made(policies=["replay", "yield"], cases=[{"scenario": "demo", "ego_id": "egos"}], seeds=[1, 2, 3])
    for processes in (1, 2, 50):
        found = batches(cases, processes)
        assert sorted(case.id for some in found for case in some) == sorted(case.id for case in cases)
        assert all(len({case.policy for case in some}) == 1 and len(some) <= BATCH_MAX for some in found)
        assert len(found) >= min(processes, len(cases))
    assert max(len(some) for some in batches(cases, 2)) == BATCH_MAX
    policies = [some[0].policy for some in batches(cases, 2)]
    assert policies == sorted(policies, key=["yield", "replay"].index), "what is quick fills what is left at the end"
    external = made(egos=[{"kind": "external", "command": ["true"]}])
    assert [len(some) for some in batches(external, 1)] == [1] * len(external)


def test_each_comes_to_the_same_as_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases, groups = made(), []

    def noted(plans: list[Any]) -> Any:
        groups.append(len(plans))
        return record_batch(plans)

    monkeypatch.setattr(batched, "record_batch", noted)
    folders = [tmp_path / str(k) for k in range(len(cases))]
    for folder in folders:
        folder.mkdir()
    found = run_batch(cases, folders)
    assert groups == [len(cases)], "they can all be stepped together"
    for case, outcome, folder in zip(cases, found, folders, strict=True):
        assert outcome.metrics is not None and outcome.metrics["digest"] == run_in_process(case)["digest"]
        assert read_thumbnail(folder) is not None


def test_one_that_fails_ends_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    cases = made(egos=["log"])
    lost, other = run_batch([replace(cases[0], ego_id=99999), cases[1]], [None, None])
    assert lost.metrics is None and "99999" in lost.failure
    assert other.metrics is not None
    monkeypatch.setattr(batched, "record_batch", lambda _: 1 // 0)
    assert all(each.metrics is not None for each in run_batch(cases, [None, None])), "they are run alone"
