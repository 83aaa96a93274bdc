"""Any stack drives the ego over the ego port; one that fails ends the run with a clear word."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.scene import Controller
from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import read_run

STACK = Path(__file__).parents[1] / "programs/external_ego.py"


def test_the_ego_is_under_its_control_in_a_domain_that_nobody_had_to_choose(recorded: Any) -> None:
    done, bag = recorded("external", "litsim").done, recorded("external", "litsim").bag
    assert done.returncode == 0, done.stderr
    assert re.search(r"^run .* in ROS_DOMAIN_ID \d+$", done.stdout, re.MULTILINE)
    assert all(re.search(r"step/s\] *$", line) for line in done.stderr.splitlines() if line), "more than the progress"
    assert (bag / "log/ads.log").is_file()
    metrics = json.loads((bag / "metrics.json").read_text())
    assert (metrics["valid"], metrics["ego"], metrics["steps"]) == (True, "external", 35)
    port = metrics["lockstep"].pop("ego_port")
    assert metrics["lockstep"] == {"missed": 0, "gaps": 0, "missed_by_topic": {}}
    assert (port["interface"], port["answered"], port["invalid"]) == ("control", 36, 0)
    run = read_run(bag)
    driven = [table.take(table.id == run.info.ego_id) for table in run.tables[run.info.history_steps + 1 :]]
    assert all((ego.controller == Controller.EGO).all() for ego in driven)
    speed = np.concatenate([ego.speed for ego in driven])
    assert np.diff(speed)[3:] == pytest.approx(np.maximum(-0.1, -speed[3:-1]), abs=1e-6)  # jerk is limited at first


def test_a_record_is_played_into_a_stack_open_loop(recorded: Any, graph: Any) -> None:
    """A stack that answers as in the record commands the same; all moves as recorded whatever it answers."""
    bag, out = recorded("external", "litsim").bag, graph.folder / "played"
    words = (bag, "--to-stack", "--out", out, "--json", graph.folder / "difference.json")
    done = graph.finish(graph.start_program("litsim_eval", "rerun", *words, "--", sys.executable, STACK))
    assert done.returncode == 0, done.stdout + done.stderr
    run, played = read_run(bag), read_run(out)
    begin = run.info.history_steps
    assert f"{len(run.tables) - begin} answers: equal to the recorded commands" in done.stdout
    difference = json.loads((graph.folder / "difference.json").read_text())
    assert (difference["acceleration"]["largest"], difference["unusable"]) == (0.0, 0)
    for then, now in zip(run.tables[:-1], played.tables, strict=False):
        assert np.array_equal(then.id, now.id) and np.allclose(then.x, now.x, atol=1e-9)
    assert len(played.tables) == len(run.tables) and sorted(played.ego_commands) == sorted(run.ego_commands)


def test_answers_that_are_missing_or_of_no_use_are_held_where_the_user_says_so(graph: Any) -> None:
    hold = ("--on-missing", "hold", "--on-invalid", "hold", "--answer-timeout", 6)
    words = ("--scenario", graph.scenario(), "--ego", "external", "--out", graph.folder / "run", *hold)
    done = graph.launch(*words, "--", sys.executable, STACK, "--skip", "20-20", "--nan-at", 12)
    assert done.returncode == 1
    assert "the run is not valid: " in done.stderr and "Traceback" not in done.stderr
    assert "1 answers missed on /litsim/ego/control" in done.stderr
    assert "1 answers of the ego could not be used" in done.stderr
    metrics = json.loads((graph.folder / "run/metrics.json").read_text())
    assert metrics["steps"] == 35
    assert metrics["lockstep"]["missed_by_topic"] == {"/litsim/ego/control": 1}
    assert metrics["lockstep"]["ego_port"]["invalid"] == 1
    run = read_run(graph.folder / "run")
    assert sorted(run.ego_commands) == list(range(36))  # what was applied
    answered = {m.log_time_ns // 10**8 for m in BagReader(graph.folder / "run").messages(["/litsim/ego/control"])}
    assert set(range(36)) - answered == {20}
    acceleration = [table.acceleration[table.row(run.info.ego_id)] for table in run.tables[18:24]]
    assert acceleration == pytest.approx([-1.0] * 6)
    said = [(s.step, s.text) for s in run.statuses if s.stage == "bridge" and s.text.startswith("missed ")]
    assert said == [(20, "missed /litsim/ego/control")]
