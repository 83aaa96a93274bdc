"""The WebSocket server that Foxglove connects to, met by an ordinary WebSocket client."""

import importlib
import socket
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.nodes.live_server import LiveServer
from litsim_sim.record.bag import BagTopic

STATE = BagTopic("/state", "made_msgs/msg/State", "int32 a\n")
OTHER = BagTopic("/other", "made_msgs/msg/Other", "int32 b\n")
CDR = b"\0\1\0\0\7\0\0\0"


@pytest.fixture
def server() -> Iterator[LiveServer]:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    made = LiveServer([STATE, OTHER], port=0, origins=["https://named.example"])
    yield made
    made.close()


@pytest.fixture
def client(server: LiveServer, foxglove_client: Any) -> Any:
    return foxglove_client(server.url)


def test_topics_are_advertised_with_their_definitions(client: Any) -> None:
    assert client.channels["/state"] | {"id": 0} == {
        "id": 0,
        "topic": "/state",
        "encoding": "cdr",
        "schemaName": "made_msgs/msg/State",
        "schema": "int32 a\n",
        "schemaEncoding": "ros2msg",
    }
    assert client.channels.keys() == {"/state", "/other"}


def test_messages_arrive_as_they_are(server: LiveServer, client: Any) -> None:
    assert not server.wants("/state")
    client.subscribe("/state")
    client.wait(lambda: server.wants("/state"))
    assert not server.wants("/other")
    server.time(2_500_000_000)
    server.send("/other", b"\0\1\0\0", 2_500_000_000)
    server.send("/state", CDR, 2_500_000_000)
    arrived = {client.receive(), client.receive()}  # the server sends times beside messages, in no certain order
    assert arrived == {("time", 2_500_000_000, b""), ("/state", 2_500_000_000, CDR)}


def test_who_comes_late_gets_the_last_message(server: LiveServer, client: Any) -> None:
    server.send("/state", b"\0\1\0\0\6\0\0\0", 100)
    server.send("/state", CDR, 200)
    client.subscribe("/state")
    client.wait(lambda: server.wants("/state"))
    client.wait(lambda: server.welcome() or client.arrived())
    assert client.receive() == ("/state", 200, CDR)


@pytest.fixture
def connect(server: LiveServer) -> Callable[..., Any]:
    """Connects as a page of an origin does, by a name of this machine."""
    client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
    port = int(server.url.rsplit(":", 1)[1])

    def connect(origin: str | None, name: str = "127.0.0.1") -> Any:
        sock = socket.create_connection(("127.0.0.1", port))
        return client.connect(f"ws://{name}:{port}", origin=origin, sock=sock, subprotocols=["foxglove.sdk.v1"])

    return connect


@pytest.mark.parametrize(
    "origin", [None, "https://app.foxglove.dev", "file://", "http://localhost:8080", "https://named.example"]
)
def test_programs_and_known_pages_may_connect(connect: Callable[..., Any], origin: str | None) -> None:
    with connect(origin) as connection:
        assert "litsim" in connection.recv()


@pytest.mark.parametrize(
    ("origin", "name", "reason"),
    [
        ("https://evil.example", "127.0.0.1", "pages of https://evil.example may not read this run"),
        ("null", "127.0.0.1", "pages of null may not read this run"),
        (None, "evil.example", "evil.example is no name of this machine"),
    ],
)
def test_other_pages_may_not(connect: Callable[..., Any], origin: str | None, name: str, reason: str) -> None:
    with pytest.raises(importlib.import_module("websockets.exceptions").InvalidStatus) as refused:
        connect(origin, name)
    assert reason in refused.value.response.body.decode()


def test_a_port_that_is_taken_is_named(server: LiveServer) -> None:
    port = int(server.url.rsplit(":", 1)[1])
    with pytest.raises(InputError, match=rf"cannot listen on 127.0.0.1:{port}: .*in use"):
        LiveServer([STATE], port=port)


def test_without_the_sdk_the_command_that_installs_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(InputError, match=r"foxglove-sdk is not installed here, .* `make setup-all` installs it"):
        LiveServer([STATE], port=0)
