"""A recorded run published again over real DDS."""

import os
import pty
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ament_index_python.packages import get_package_prefix
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from litsim_sim.record.bag import BagReader
from litsim_sim.ros import topics
from observer import PATIENCE_S, Observer

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
    replay = graph.start_node("litsim_sim", "replay", bag, "--paused", "--delay", "0", "--topics", *chosen)
    expected, heard = in_bag(bag), listener.heard
    clock, agents = expected["/clock"], expected["/litsim/agents"]
    listener.wait("publishers", lambda: all(listener.node.count_publishers(t.name) for t in (topics.CLOCK, *CHOSEN)))
    assert listener.set("rate", 1.0).successful  # whom it answers it has found, and what he listens to before that
    assert not any(heard.values())

    assert listener.call(Trigger, "/replay/step", Trigger.Request()).success
    listener.wait("step 0", lambda: heard["/litsim/agents"] and heard["/litsim/run_info"])
    assert (heard["/clock"], heard["/litsim/agents"]) == (clock[:1], agents[:1])
    assert listener.set("seek_to", 2.0).successful
    listener.wait("step 20", lambda: len(heard["/litsim/agents"]) == 2)
    assert (heard["/clock"][-1], heard["/litsim/agents"][-1]) == (clock[20], agents[20])
    for name, value in (("rate", -1.0), ("seek_to", 99.0)):
        refused = listener.set(name, value)
        assert not refused.successful and f"{name} is {value:g}, expected" in refused.reason
    assert listener.set("seek_to", 0.0).successful
    listener.wait("step 0 again", lambda: len(heard["/litsim/agents"]) == 3 and len(heard["/litsim/controls"]) == 3)

    for messages in heard.values():
        del messages[:-1]
    assert listener.set("rate", 5.0).successful
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


def test_keys(graph: Any, recorded: Any) -> None:
    ours, theirs = pty.openpty()
    program = Path(get_package_prefix("litsim_sim")) / "lib" / "litsim_sim" / "replay"
    environment = os.environ | {"ROS_DOMAIN_ID": str(graph.domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    words = [program, recorded("idm", "litsim").bag, "--paused", "--delay", "0"]
    process = subprocess.Popen(words, stdin=theirs, stderr=theirs, stdout=subprocess.DEVNULL, env=environment)
    said = ""

    def expect(text: str) -> None:
        nonlocal said
        end = time.monotonic() + PATIENCE_S
        while text not in said:
            assert time.monotonic() < end, said
            said += os.read(ours, 4096).decode()

    try:
        expect("paused")
        for keys, shown in ((b"ss", "0.1 / 3.5 s  x1.00  paused"), (b"+", "x1.25"), (b"\x1b[D", "0.0 / 3.5 s  x1.25")):
            os.write(ours, keys)
            expect(shown)
        os.write(ours, b" ")
        expect("playing")
        os.write(ours, b"q")
        assert process.wait(timeout=PATIENCE_S) == 0
    finally:
        process.kill()
        os.close(theirs)
        os.close(ours)
