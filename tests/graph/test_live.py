"""The live view beside a replay and beside a run."""

import json
import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from visualization_msgs.msg import Marker, MarkerArray

from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import read_run
from litsim_sim.ros import topics
from observer import Observer


class Viewer(Observer):
    """Keeps the markers as RViz does: what is added and not deleted since."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain)
        self.shown: dict[str, dict[tuple[str, int], Marker]] = {topic.name: {} for topic in topics.MARKERS}
        for topic in topics.MARKERS:
            self.node.create_subscription(topic.type, topic.name, self._receiver(topic.name), topic.qos)

    def _receiver(self, name: str) -> Callable[[MarkerArray], None]:
        def receive(message: MarkerArray) -> None:
            for marker in message.markers:
                if marker.action == Marker.DELETE:
                    self.shown[name].pop((marker.ns, marker.id), None)
                else:
                    self.shown[name][marker.ns, marker.id] = marker

        return receive

    def boxes(self) -> dict[tuple[float, float], Marker]:
        """Agents that are shown, by where they are."""
        agents = self.shown[topics.MARKERS_AGENTS.name].values()
        return {(m.pose.position.x, m.pose.position.y): m for m in agents if m.ns == "agents"}

    def show(self, step: int, expected: set[tuple[float, float]]) -> None:
        """Ask the replay for a step until it is seen: who hears the replay may not have been found by it."""

        def shown() -> bool:
            sought = [Parameter("seek_to", value=0.1 * step).to_parameter_msg()]
            self.call(SetParameters, "/replay/set_parameters", SetParameters.Request(parameters=sought))
            until = time.monotonic() + 1.0
            while self.boxes().keys() != expected and time.monotonic() < until:
                self.executor.spin_once(timeout_sec=0.05)
            return self.boxes().keys() == expected

        self.wait(f"step {step}", shown)


@pytest.fixture
def viewer(graph: Any) -> Iterator[Viewer]:
    with Viewer(graph.domain) as viewing:
        yield viewing


def places(bag: Path) -> list[set[tuple[float, float]]]:
    """Where the agents are at each step."""
    return [set(zip(t.x.tolist(), t.y.tolist(), strict=True)) for t in read_run(bag).tables]


def decoded(channel: dict[str, str], data: bytes) -> Any:
    """A message by the definition that a server has advertised, without ROS."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    return store.deserialize_cdr(data, channel["schemaName"])


def test_a_paused_replay_shows_every_step(graph: Any, viewer: Viewer, recorded: Any) -> None:
    bag = recorded("idm", "litsim").bag
    live = graph.start_node("litsim_sim", "live")
    graph.start_node("litsim_sim", "replay", bag, "--paused")
    expected = places(bag)
    for step in range(3):
        viewer.show(step, expected[step])
    with Viewer(graph.domain) as late:
        late.wait("the step that stands", lambda: late.boxes().keys() == expected[2])
    code, said = graph.end(live)
    assert code == 0 and "Traceback" not in said, said


def test_forecasts_and_conflicts_come_and_go(graph: Any, viewer: Viewer, recorded: Any) -> None:
    bag = recorded("idm", "litsim").bag
    run = read_run(bag)
    held = [step for step, found in run.takeovers.items() if any(t.state == 0 for t in found)]
    assert held, "nobody is taken over"
    graph.start_node("litsim_sim", "live")
    graph.start_node("litsim_sim", "replay", bag, "--loop", "--rate", "2")
    forecasts, conflicts = (viewer.shown[t.name] for t in (topics.MARKERS_FORECASTS, topics.MARKERS_CONFLICTS))
    viewer.wait("forecasts", lambda: forecasts)
    viewer.wait("a conflict", lambda: {"conflicts", "paths", "goals"} <= {ns for ns, _ in conflicts})
    viewer.wait("its end, at the latest with the next round", lambda: not conflicts)


def test_a_live_view_that_hangs_or_dies_does_not_touch_the_run(graph: Any, recorded: Any) -> None:
    """The run begins once its ego does, and waits for it at step 5 with the step before on show."""
    usual, bag = recorded("external", "litsim").bag, graph.folder / "run"
    words = ("--scenario", graph.scenario(), "--out", bag, "--ego", "external", "--domain-id", graph.domain)
    live = [graph.start_node("litsim_sim", "live", "--rate", "100") for _ in range(2)]
    with Viewer(graph.domain) as viewer:  # without anybody who looks it does nothing
        viewer.wait("both", lambda: len(viewer.node.get_publishers_info_by_topic(topics.MARKERS_AGENTS.name)) == 2)
        live[0].send_signal(signal.SIGSTOP)  # from before the first step on, so that whatever it holds up is held up
        launcher = graph.start_launch(*words, "--answer-timeout", 30)
        viewer.wait("markers", viewer.boxes)
        first = viewer.boxes().keys()
        graph.start_script("external_ego.py", "--late", "5-5", "--late-by", 2)
        viewer.wait("markers of a later step", lambda: viewer.boxes().keys() != first)
        live[1].kill()
        done = graph.finish(launcher)
        live[0].send_signal(signal.SIGCONT)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((bag / "metrics.json").read_text())
    assert metrics["valid"], metrics["why"]
    assert metrics["digest"] == json.loads((usual / "metrics.json").read_text())["digest"]
    assert not [name for name in BagReader(bag).topics if name.startswith("/litsim/markers")]


def test_foxglove_gets_the_topics_and_the_markers(graph: Any, recorded: Any, foxglove_client: Any) -> None:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    bag = recorded("idm", "litsim").bag
    live = graph.start_node("litsim_sim", "live", "--foxglove", "--port", "0")
    url = ""
    while not url:
        line = live.stderr.readline()
        assert line, "the live view has ended"
        url = "".join(re.findall(r"ws://\S+", line))
    client = foxglove_client(url)
    names = {topic.name for topic in (topics.AGENTS, topics.TAKEOVERS, topics.EGO_STATE, topics.MARKERS_AGENTS)}
    assert names <= client.channels.keys()
    client.subscribe(topics.AGENTS.name, topics.MARKERS_AGENTS.name, topics.RUN_INFO.name)
    graph.start_node("litsim_sim", "replay", bag, "--loop")  # who listens may not be found before its end
    heard: dict[str, list[tuple[int, bytes]]] = {}

    def enough() -> bool:
        while client.arrived():
            name, time_ns, data = client.receive()
            heard.setdefault(name, []).append((time_ns, data))
        return {topics.AGENTS.name, topics.MARKERS_AGENTS.name, topics.RUN_INFO.name, "time"} <= heard.keys()

    client.wait(enough)
    sent = {m.log_time_ns: m.data for m in BagReader(bag).messages({topics.AGENTS.name})}
    assert all(sent[time_ns] == data for time_ns, data in heard[topics.AGENTS.name])
    time_ns, data = heard[topics.MARKERS_AGENTS.name][0]
    boxes = [m for m in decoded(client.channels[topics.MARKERS_AGENTS.name], data).markers if m.ns == "agents"]
    assert {(m.pose.position.x, m.pose.position.y) for m in boxes} == places(bag)[time_ns // 10**8]
    code, said = graph.end(live)
    assert code == 0 and "Traceback" not in said, said
