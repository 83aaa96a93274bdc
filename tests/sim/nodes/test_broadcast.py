"""What the bridge publishes of a step, with publishers that only take note."""

import logging
from typing import Any

import numpy as np
import pytest

from litsim_sim.nodes.broadcast import Broadcast
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan
from litsim_sim.scenario.scenario import Scenario


class Notes:
    """A node and all its publishers: notes the topics and stamps of what is published."""

    def __init__(self) -> None:
        self.published: list[tuple[str, int]] = []
        self.subscribers: dict[str, int] = {}
        self.newest: dict[str, Any] = {}

    def get_logger(self) -> Any:
        return logging.getLogger()

    def create_publisher(self, _: Any, topic: str, *__: Any, **___: Any) -> Any:
        return _Publisher(self, topic)

    def steps(self, topic: str) -> list[int]:
        """Steps of the messages on `topic` since the last call for any topic."""
        found, self.published = [step for name, step in self.published if name == topic], []
        return found


class _Publisher:
    def __init__(self, notes: Notes, topic: str) -> None:
        self._notes, self._topic = notes, topic

    def publish(self, message: Any) -> None:
        self._notes.newest[self._topic] = message
        if hasattr(message, "markers"):  # of lights, of which there are none here
            return
        stamp = message.header.stamp if hasattr(message, "header") else message.clock
        self._notes.published.append((self._topic, 10 * stamp.sec + stamp.nanosec // 100_000_000))

    def get_subscription_count(self) -> int:
        return self._notes.subscribers.get(self._topic, 0)


@pytest.mark.parametrize("topic", ["/litsim/objects", "/litsim/lights"])
def test_clouds_reach_a_stack_that_is_started_while_a_step_waits_for_it(topic: str) -> None:
    scenario, notes = Scenario.load("demo"), Notes()
    broadcast = Broadcast(notes, RunPlan(scenario, EXTERNAL, "replay"))
    for step in (0, 1):
        broadcast.show(scenario.log.table(step))
        broadcast.accompany(scenario.log.table(step))
    assert notes.steps(topic) == [0], "made for nobody"
    broadcast.repeat()
    assert notes.steps(topic) == []
    notes.subscribers[topic] = 1
    for _ in range(2):
        broadcast.repeat()
        assert notes.steps(topic) == [1]
    broadcast.show(scenario.log.table(2))
    broadcast.accompany(scenario.log.table(2))
    assert notes.steps(topic) == [2]


def test_objects_are_what_the_ego_is_told_and_agents_the_truth(make_scenario, track) -> None:
    hide = {"kind": "hide", "agent": 2, "begin_s": 1.0, "duration_s": 0.5}
    tracks = (track(1, x=100.0), track(2, x=140.0), track(3, x=170.0))
    scenario, notes = make_scenario(*tracks, changes=[hide, {"kind": "noise", "sigma_m": 0.5}]), Notes()
    notes.subscribers["/litsim/objects"] = 1
    broadcast = Broadcast(notes, RunPlan(scenario, EXTERNAL, "replay"))
    for step, told in ((9, [2, 3]), (10, [3]), (14, [3]), (15, [2, 3])):
        table = scenario.log.table(step)
        broadcast.show(table)
        broadcast.accompany(table)
        cloud = notes.newest["/litsim/objects"]
        layout = {field.name: (" bBhHiIfd"[field.datatype], field.offset) for field in cloud.fields}
        objects = np.frombuffer(cloud.data, layout)
        assert objects["id"].tolist() == told
        errors = objects["x64"] - [table.x[table.row(agent)] for agent in told]
        assert (errors != 0.0).all() and (np.abs(errors) < 3.0).all()
        assert list(notes.newest["/litsim/agents"].id) == [1, 2, 3]
        assert list(notes.newest["/litsim/agents"].x) == table.x.tolist()
