"""Nobody changes a run unseen: a foreign publisher on an internal topic ends the run, and is named."""

from typing import Any

import pytest

from litsim_sim.nodes.publishers import STAGES, Visits, owners
from litsim_sim.nodes.responses import RunFailed
from litsim_sim.ros.endpoints import subscribe
from observer import Observer


def test_a_visit_to_any_internal_topic_is_noticed_though_it_is_over(graph: Any) -> None:
    with Observer(graph.domain) as host, Observer(graph.domain) as guest:
        visits = Visits(host.node)
        internal = dict.fromkeys(owners(STAGES, external=True, applied=True, signals=True), ())
        for topic in internal:
            subscribe(host.node, topic, lambda _: None, matched=visits.of(topic))
        for topic in internal:
            publisher = guest.node.create_publisher(topic.type, topic.name, topic.qos)
            guest.wait("the host to be there", publisher.get_subscription_count)
            guest.node.destroy_publisher(publisher)
            with pytest.raises(RunFailed, match=rf"^an unknown node: publishes on {topic.name}, expected nobody; "):
                host.wait("the visit to be told", lambda: visits.check(internal))


def test_somebody_who_speaks_of_another_run_is_named(graph: Any) -> None:
    """What the stranger says is nonsense in every field, and nobody trips over it."""
    graph.start_script("stranger.py")
    graph.start_node("litsim_policy", "ego")
    given = {"scenario": graph.scenario(), "policy": "replay", "progress": "none"}
    bridge = graph.finish(graph.start_node("litsim_sim", "bridge", **given))
    assert bridge.returncode == 1
    assert "/stranger: publishes on /litsim/" in bridge.stderr
    assert "Traceback" not in bridge.stderr
