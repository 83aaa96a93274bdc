"""Watch over the publishers of the graph: nobody but the nodes of a run may publish on its internal topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.node import Node

from litsim_sim.core.stages import BRIDGE, CONFLICT, EGO, POLICY, POLICY_STAGES, PREDICTOR, RECORDER
from litsim_sim.nodes.broadcast import PUBLISHED, PUBLISHED_OF_SIGNALS
from litsim_sim.nodes.responses import RunFailed
from litsim_sim.ros.endpoints import node_of, once_named
from litsim_sim.ros.topics import (
    CONTROLS,
    EGO_APPLIED,
    EGO_CONTROL,
    FORECASTS,
    HELLO,
    RECORDED,
    STATUS,
    TAKEOVERS,
    TIMING,
    Topic,
)

WATCH_S = 1.0  # [s] period of the watch over topics that the bridge does not hear; :class:`Visits` are told at once

STAGES = (*POLICY_STAGES, EGO, RECORDER)

Owners = Mapping[Topic, tuple[str, ...]]
"""Names of the nodes of a run that publish on each internal topic."""


def owners(stages: Sequence[str], *, external: bool, applied: bool, signals: bool) -> Owners:
    """Returns the internal topics with their owners; the ego's commands are internal unless the ego is `external`.

    A topic that the run does without has no owners, such as those of signals.
    """
    of_stages = {FORECASTS: PREDICTOR, TAKEOVERS: CONFLICT, CONTROLS: POLICY, RECORDED: RECORDER}
    of_stages |= {} if external else {EGO_CONTROL: EGO}
    of_bridge = (*PUBLISHED, HELLO, *((EGO_APPLIED,) if applied else ()), *(PUBLISHED_OF_SIGNALS if signals else ()))
    return (
        dict.fromkeys((*PUBLISHED_OF_SIGNALS, EGO_APPLIED), ())
        | dict.fromkeys(of_bridge, (BRIDGE,))
        | {topic: (stage,) if stage in stages else () for topic, stage in of_stages.items()}
        | {STATUS: (BRIDGE, *stages), TIMING: (BRIDGE, *(stage for stage in stages if stage != RECORDER))}
    )


def check_publishers(node: Node, internal: Owners) -> None:
    """Check, as `node` sees the graph, that no topic has more publishers than it has owners.

    A node of any name could answer in place of a stage, so publishers are counted, and names only tell who it is.

    Raises:
        RunFailed: there is a publisher too many; the message names the topic, and the nodes that are no owners.
    """
    for topic, names in internal.items():
        if node.count_publishers(topic.name) > len(names) and (text := surplus(topic.name, names, _nodes(node, topic))):
            raise RunFailed(text)


class Visits:
    """Publishers that come to the topics that a node hears, however shortly they stay: DDS itself counts them.

    A subscription gets no message of a publisher that has not been counted before.
    """

    def __init__(self, node: Node) -> None:
        """Tell of visits to subscriptions of `node`."""
        self._node = node
        self._most: dict[Topic, int] = {}  # topics with new publishers; most that they have had at a time since

    def of(self, topic: Topic) -> Callable[[Any], None]:
        """Returns what a subscription of `topic` calls when publishers come and go."""

        def note(status: Any) -> None:
            if status.total_count_change:
                before = status.current_count - status.current_count_change
                self._most[topic] = max(before + status.total_count_change, self._most.get(topic, 0))

        return note

    def check(self, internal: Owners) -> None:
        """Raise RunFailed if there were more publishers than owners; the message names them, as far as still known."""
        while self._most:
            topic, most = self._most.popitem()
            names = internal.get(topic)
            if names is None or most <= len(names):
                continue
            nodes = _nodes(self._node, topic)
            if text := surplus(topic.name, names, nodes):
                raise RunFailed(text)
            if most > len(names) + len(_idle(names) & {*nodes}):
                raise RunFailed(surplus(topic.name, names, [*(f"/{name}" for name in names), ""]))


def _idle(names: Sequence[str]) -> set[str]:
    """Returns full names of the stages that take no part in the run, by the owners of a topic."""
    return {f"/{stage}" for stage in {*STAGES} - {*names} if len(names) != 1}


def surplus(topic: str, names: Sequence[str], nodes: Sequence[str]) -> str:
    """Returns a text that tells of publishers on `topic` beyond its owners `names`; empty for none.

    A stage that takes no part in the run may be there, idle: LitSim's own ego, say, beside an external one. Full
    names of all their `nodes` are empty where unknown.
    """
    idle = _idle(names)
    taking_part = [node for node in nodes if node not in idle]
    if len(taking_part) <= len(names):
        return ""
    strangers = list(taking_part)
    for name in names:
        if f"/{name}" in strangers:
            strangers.remove(f"/{name}")
    if f"/{BRIDGE}" in strangers:
        return f"another bridge publishes on {topic} in the same domain; each needs a domain of its own"
    who = ", ".join(sorted(node or "an unknown node" for node in strangers))
    expected = f"only {', '.join(names)} of this run" if names else "nobody"
    return (
        f"{who}: publishes on {topic}, expected {expected}; a graph needs a domain of its own, and a stack publishes "
        "on the ego's topics"
    )


def _nodes(node: Node, topic: Topic) -> list[str]:
    """Returns names of the nodes that publish on `topic`."""
    return list(map(node_of, once_named(lambda: node.get_publishers_info_by_topic(topic.name), node_of)))
