"""A recorded run published again over real DDS."""

import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool

from litsim_sim.record.bag import BagReader
from litsim_sim.ros import topics
from observer import Observer

CHOSEN = (topics.AGENTS, topics.CONTROLS, topics.RUN_INFO)
LISTENED = (topics.CLOCK, *CHOSEN, topics.TAKEOVERS)


class Listener(Observer):
    """Keeps every message as it comes, and asks the replay for things."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain)
        self.heard: dict[str, list[bytes]] = {topic.name: [] for topic in LISTENED}
        for topic in LISTENED:
            self.node.create_subscription(topic.type, topic.name, self.heard[topic.name].append, topic.qos, raw=True)

    def set(self, name: str, value: float) -> Any:
        asked = [Parameter(name, value=value).to_parameter_msg()]
        (result,) = self.call(SetParameters, "/replay/set_parameters", SetParameters.Request(parameters=asked)).results
        return result


@pytest.fixture
def listener(graph: Any) -> Iterator[Listener]:
    with Listener(graph.domain) as listening:
        yield listening


def in_bag(bag: Path) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = {topic.name: [] for topic in (topics.CLOCK, *CHOSEN)}
    for message in BagReader(bag).messages(found):
        found[message.topic].append(message.data)
    return found


def test_every_message_of_the_chosen_topics_in_order_with_the_clock(graph: Any, recorded: Any, listener: Any) -> None:
    bag = recorded("idm", "litsim").bag
    chosen = [topic.name for topic in CHOSEN]
    replay = graph.start_node("litsim_sim", "replay", bag, "--paused", "--rate", 5, "--delay", 0, "--topics", *chosen)
    expected, heard = in_bag(bag), listener.heard
    clock, agents = expected["/clock"], expected["/litsim/agents"]
    listener.wait("publishers", lambda: all(listener.node.count_publishers(t.name) for t in (topics.CLOCK, *CHOSEN)))
    assert listener.set("seek_to", 0.0).successful
    listener.wait("step 0", lambda: heard["/litsim/agents"] and heard["/litsim/run_info"])
    assert (heard["/clock"], heard["/litsim/agents"]) == (clock[:1], agents[:1])
    assert listener.set("seek_to", 2.0).successful
    listener.wait("step 20", lambda: len(heard["/litsim/agents"]) == 2)
    assert (heard["/clock"][-1], heard["/litsim/agents"][-1]) == (clock[20], agents[20])
    refused = listener.set("seek_to", 99.0)
    assert not refused.successful and "seek_to is 99, expected 0 to 3.5 s" in refused.reason
    assert listener.set("seek_to", 0.0).successful
    listener.wait("step 0 again", lambda: len(heard["/litsim/agents"]) == 3 and len(heard["/litsim/controls"]) == 3)

    for messages in heard.values():
        del messages[:-1]
    begin = time.monotonic()
    assert listener.call(SetBool, "/replay/pause", SetBool.Request(data=False)).success
    listener.wait("the end", lambda: len(heard["/litsim/controls"]) == len(expected["/litsim/controls"]))
    assert time.monotonic() - begin > 0.9 * 3.5 / 5.0
    done = graph.finish(replay)
    assert done.returncode == 0, done.stderr
    listener.executor.spin_once(timeout_sec=0.1)
    del heard["/litsim/run_info"][:-1]  # latched: that of the way back to the start may come in late
    assert heard == expected | {"/litsim/takeovers": []}


def test_latched_topics_reach_those_who_come_late_and_ctrl_c_is_clean(graph: Any, recorded: Any) -> None:
    bag = recorded("idm", "litsim").bag
    replay = graph.start_node("litsim_sim", "replay", bag, "--loop", "--rate", "2", "--start", "1", "--delay", "0")
    with Listener(graph.domain) as late:
        expected = in_bag(bag)
        late.wait("what is latched", lambda: late.heard["/litsim/run_info"] == expected["/litsim/run_info"])
        late.wait("the next round", lambda: expected["/clock"][0] in late.heard["/clock"])
    code, said = graph.end(replay, signal.SIGINT)
    assert code == 0 and "Traceback" not in said, said
