"""Stages that share a process: what is read once, what is handed on, and when the rest is done."""

from types import SimpleNamespace
from typing import Any

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.ros import in_process as module
from litsim_sim.ros.in_process import InProcessTransport
from litsim_sim.ros.topics import AGENTS, FORECASTS, TAKEOVERS, Topic
from litsim_sim.scenario.scenario import Scenario

Heard = list[tuple[str, str, int, Any]]


@pytest.fixture
def dds(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What is subscribed to over DDS: by topic, what takes its messages."""
    found: dict[str, Any] = {}
    monkeypatch.setattr(module, "subscribe", lambda node, topic, take: found.setdefault(f"{node} {topic.name}", take))
    return found


def listener(name: str, heard: Heard) -> Any:
    def receive(run_id: str, step: int, read: Any) -> None:
        heard.append((name, run_id, step, read()))

    return receive


def message(step: int = 3) -> Any:
    return SimpleNamespace(run_id="run", step=step, x=[1.0])


def listen(transport: InProcessTransport, node: Any, topic: Topic, read: Any, heard: Heard) -> None:
    transport.listen(node, topic, read, listener(str(node), heard))


def test_what_comes_for_several_is_subscribed_to_once_and_read_once(dds: dict[str, Any]) -> None:
    transport, heard, reads = InProcessTransport(), [], []

    def read(given: Any) -> str:
        reads.append(given)
        return "table"

    listen(transport, "predictor", AGENTS, read, heard)
    listen(transport, "conflict", AGENTS, read, heard)
    assert list(dds) == ["predictor /litsim/agents"]
    dds["predictor /litsim/agents"](message())
    assert heard == [("predictor", "run", 3, "table"), ("conflict", "run", 3, "table")]
    assert len(reads) == 1
    dds["predictor /litsim/agents"](message(4))
    assert len(reads) == 2


def test_what_cannot_be_read_fails_for_each_who_reads_it(dds: dict[str, Any]) -> None:
    transport, failed = InProcessTransport(), []

    def read(_: Any) -> None:
        raise InputError("no numbers")

    def receive(run_id: str, step: int, read: Any) -> None:
        with pytest.raises(InputError):
            read()
        failed.append((run_id, step))

    transport.listen("one", AGENTS, read, receive)
    transport.listen("other", AGENTS, read, receive)
    dds["one /litsim/agents"](message())
    assert failed == [("run", 3)] * 2


def test_an_answer_goes_to_those_that_listen_here_and_not_over_dds(dds: dict[str, Any]) -> None:
    transport, heard = InProcessTransport(), []
    transport.join(FORECASTS)
    listen(transport, "conflict", FORECASTS, str, heard)
    assert not dds
    forecast = object()
    assert transport.has_listener(FORECASTS) and not transport.has_listener(TAKEOVERS)
    transport.publish(FORECASTS, forecast, "run", 7)
    assert heard == [("conflict", "run", 7, forecast)]


def test_a_stage_alone_waits_for_nobody_here(dds: dict[str, Any]) -> None:
    transport, heard = InProcessTransport(), []
    listen(transport, "conflict", FORECASTS, str, heard)
    transport.join(TAKEOVERS)
    assert list(dds) == ["conflict /litsim/forecasts"]
    assert not transport.has_listener(TAKEOVERS)


def test_what_nobody_waits_for_is_done_once_all_have_been_served(dds: dict[str, Any]) -> None:
    transport, order = InProcessTransport(), []

    def first(*_: Any) -> None:
        transport.defer(lambda: transport.defer(lambda: order.append("last")))
        transport.defer(lambda: order.append("afterwards"))
        order.append("first")

    transport.listen("one", AGENTS, str, first)
    transport.listen("other", AGENTS, str, lambda *_: order.append("second"))
    dds["one /litsim/agents"](message())
    assert order == ["first", "second", "afterwards", "last"]
    transport.defer(lambda: order.append("at once"))
    assert order[-1] == "at once"


def test_it_is_done_as_well_where_somebody_fails(dds: dict[str, Any]) -> None:
    transport, order = InProcessTransport(), []

    def fails(*_: Any) -> None:
        transport.defer(lambda: order.append("afterwards"))
        raise RuntimeError

    transport.listen("one", AGENTS, str, fails)
    with pytest.raises(RuntimeError):
        dds["one /litsim/agents"](message())
    assert order == ["afterwards"]


def test_a_scenario_is_read_once_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[tuple[str, str]] = []
    monkeypatch.setattr(Scenario, "from_yaml", lambda *given: read.append(given) or object())
    transport = InProcessTransport()
    one, other = (SimpleNamespace(run_id=name, scenario_yaml=f"name: {name}") for name in ("a", "b"))
    assert transport.scenario(one) is transport.scenario(one)
    assert transport.scenario(other) is not transport.scenario(one)
    assert read[0] == ("name: a", "/litsim/run_info of run a")
    assert len(read) == 3


def test_a_scenario_that_is_loaded_is_not_read_again_and_another_is(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[tuple[str, str]] = []
    monkeypatch.setattr(Scenario, "from_yaml", lambda *given: read.append(given) or object())
    loaded = SimpleNamespace(to_yaml=lambda: "name: a")
    transport = InProcessTransport(loaded)
    assert transport.scenario(SimpleNamespace(run_id="a", scenario_yaml="name: a")) is loaded
    assert not read
    assert transport.scenario(SimpleNamespace(run_id="b", scenario_yaml="name: b")) is not loaded
    assert len(read) == 1
