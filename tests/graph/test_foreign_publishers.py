"""Nobody changes a run unseen: a foreign publisher on an internal topic ends the run, and is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from litsim_eval.analysis.analyze import analyze

INTRUDER = Path(__file__).with_name("intruder.py")


def test_a_stranger_on_an_internal_topic_ends_the_run_and_is_named(graph: Any) -> None:
    bag, topic = graph.folder / "run", "/litsim/agents"
    words = ("--scenario", graph.scenario(simulation_s=24.0), "--mode", "realtime", "--domain-id", graph.domain)
    launcher = graph.start_launch(*words, "--out", bag, "--quiet")
    graph.wait_under_way(bag)
    graph.start_script("intruder.py", topic)
    done = graph.finish(launcher)
    assert done.returncode == 1
    assert f"/intruder: publishes on {topic}, expected only " in done.stderr
    metrics = analyze(bag)
    assert not metrics["valid"]
    assert "/intruder: publishes on" in metrics["why"]


def test_a_stage_that_is_started_twice_ends_the_run(graph: Any) -> None:
    ego = ("litsim_policy", "ego")
    graph.start_node(*ego), graph.start_node(*ego)
    given = {"scenario": graph.scenario(), "policy": "replay", "progress": "none"}
    bridge = graph.finish(graph.start_node("litsim_sim", "bridge", **given))
    assert bridge.returncode == 1
    assert "/ego: publishes on /litsim/ego/control, expected only ego of this run" in bridge.stderr


def test_somebody_who_speaks_of_another_run_is_named(graph: Any) -> None:
    """What the stranger says is nonsense in every field, and nobody trips over it."""
    graph.start_script("stranger.py")
    graph.start_node("litsim_policy", "ego")
    given = {"scenario": graph.scenario(), "policy": "replay", "progress": "none"}
    bridge = graph.finish(graph.start_node("litsim_sim", "bridge", **given))
    assert bridge.returncode == 1
    assert "/stranger: publishes on /litsim/" in bridge.stderr
    assert "Traceback" not in bridge.stderr
