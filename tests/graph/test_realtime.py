"""In real time nobody is waited for: what comes late is held, counted and recorded, and the run is not valid."""

from typing import Any

from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import read_run


def test_late_and_missing_answers_are_counted(graph: Any) -> None:
    bag = graph.folder / "run"
    graph.start_script("external_ego.py", "--late", "10-12", "--late-by", 0.25, "--skip", "22-24")
    options = ("--mode", "realtime", "--ego", "external", "--out", bag, "--domain-id", graph.domain)
    done = graph.launch("--scenario", graph.scenario(), "--no-analyze", *options)
    assert done.returncode == 1
    assert "the run is not valid" in done.stderr
    assert "answers missed on /litsim/ego/control" in done.stderr

    metrics = compute_metrics(read_run(bag))
    assert metrics["why"] in done.stderr
    missed = metrics["lockstep"]["missed_by_topic"]
    assert missed["/litsim/ego/control"] >= 6
    assert metrics["steps"] == 35
    assert metrics["timing"]["wall_s"] > 3.4  # it cannot be faster than the clock
    run = read_run(bag)
    assert run.complete
    assert [table.step for table in run.tables] == list(range(36))
    answered = {message.log_time_ns // 10**8 for message in BagReader(bag).messages(["/litsim/ego/control"])}
    assert {10, 11, 12} <= answered  # late, and yet recorded
    assert {22, 23, 24}.isdisjoint(answered)
    assert sorted(run.ego_commands) == list(range(36))  # what was applied
    told = {s.step for s in run.statuses if s.text.startswith("missed ") and "/litsim/ego/control" in s.text}
    assert {10, 11, 12, 22, 23, 24} <= told
    assert len(told) == missed["/litsim/ego/control"]
    assert run.summary["stale"]["/litsim/ego/control"] >= 3
