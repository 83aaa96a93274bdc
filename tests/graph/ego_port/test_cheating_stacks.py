"""A stack under test cannot make its run another one: what it tries is told, or changes nothing (docs/security.md)."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.core.errors import InputError
from litsim_sim.record.bag import find_mcap
from litsim_sim.record.run import read_run
from litsim_sim.record.seal import read_seal

CHEAT = Path(__file__).parents[1] / "programs/cheating_stack.py"
ALONE = "publishes on /litsim/{}, expected only {} of this run"
TOLD = {
    "end": ALONE.format("recorded", "recorder"),
    "agents": ALONE.format("agents", "bridge"),
    "controls": "publishes on /litsim/controls, expected nobody",
    "run_info": ALONE.format("run_info", "bridge"),
}


def launch(graph: Any, way: str) -> tuple[Any, Path]:
    bag = graph.folder / way
    setup = ("--scenario", graph.scenario(), "--ego", "external", "--policy", "replay", "--out", bag)
    return graph.launch(*setup, "--", sys.executable, CHEAT, way, bag), bag


@pytest.mark.parametrize("way", TOLD)
def test_what_it_forges_is_told_and_the_run_is_not_valid(graph: Any, way: str) -> None:
    done, bag = launch(graph, way)
    assert done.returncode != 0
    assert TOLD[way] in done.stderr
    assert not (bag / "metrics.json").exists()
    assert not compute_metrics(read_run(bag))["valid"]


def test_a_record_that_it_writes_into_is_damaged(graph: Any) -> None:
    done, bag = launch(graph, "record")
    assert done.returncode == 2, done.stderr
    with pytest.raises(InputError, match=r"record_0\.mcap: damaged at byte \d+"):
        compute_metrics(read_run(bag))


def test_what_it_writes_or_leaves_behind_changes_nothing(graph: Any) -> None:
    """Parameters of nodes, forged measures, and a process that waits for the seal to edit the record."""
    honest, cheating = (
        (done.stderr, json.loads((bag / "metrics.json").read_text()), bag)
        for done, bag in (launch(graph, way) for way in ("nothing", "elsewhere"))
    )
    assert cheating[1]["valid"], cheating[0]
    assert cheating[1]["digest"] == honest[1]["digest"]
    assert not graph.running()
    assert read_seal(find_mcap(cheating[2])).problem == ""
