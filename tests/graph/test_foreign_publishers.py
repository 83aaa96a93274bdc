"""Nobody changes a run unseen: a foreign publisher on an internal topic ends the run, and is named."""

from __future__ import annotations

from typing import Any

from litsim_eval.report.analyze import analyze
from litsim_sim.ros.topics import AGENTS
from observer import Observer


def test_a_stranger_on_an_internal_topic_ends_the_run_and_is_named(graph: Any) -> None:
    bag = graph.folder / "run"
    words = ("--scenario", graph.scenario(simulation_s=24.0), "--mode", "realtime", "--domain-id", graph.domain)
    launcher = graph.start_launch(*words, "--out", bag, "--quiet")
    graph.wait_under_way(bag)
    with Observer(graph.domain) as stranger:
        stranger.node.create_publisher(AGENTS.type, AGENTS.name, AGENTS.qos)
        done = graph.finish(launcher)
    assert done.returncode == 1
    assert f"/observer: publishes on {AGENTS.name}, expected only " in done.stderr
    metrics = analyze(bag)
    assert not metrics["valid"]
    assert "/observer: publishes on" in metrics["why"]


def test_somebody_who_speaks_of_another_run_is_named(graph: Any) -> None:
    """What the stranger says is nonsense in every field, and nobody trips over it."""
    graph.start_script("stranger.py")
    graph.start_node("litsim_policy", "ego")
    given = {"scenario": graph.scenario(), "policy": "replay", "progress": "none"}
    bridge = graph.finish(graph.start_node("litsim_sim", "bridge", **given))
    assert bridge.returncode == 1
    assert "/stranger: publishes on /litsim/" in bridge.stderr
    assert "Traceback" not in bridge.stderr
