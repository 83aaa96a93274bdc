"""A WebSocket server for Foxglove, which forwards serialised ROS messages with their definitions. Without ROS."""

from __future__ import annotations

import errno
import importlib
import secrets
from collections.abc import Collection, Iterable
from queue import Empty, SimpleQueue
from typing import Any

from litsim_sim.core.errors import InputError, not_installed
from litsim_sim.nodes.origin_gate import OriginGate
from litsim_sim.record.bag import BagTopic

HOST, PORT = "127.0.0.1", 8765
BACKLOG = 256  # messages that a slow client may lag behind; it misses older ones


class LiveServer:
    """Serves topics to any number of clients; :meth:`send` never blocks.

    A client that subscribes gets the last message of the topic, however old; see :meth:`welcome`.
    """

    def __init__(
        self, topics: Iterable[BagTopic], host: str = HOST, port: int = PORT, origins: Collection[str] = ()
    ) -> None:
        """Listen on `host`:`port`; port 0 is a free one. Pages of `origins` may connect, too; see :class:`OriginGate`.

        Raises:
            InputError: foxglove-sdk or websockets is not installed, or the address is not available.
        """
        try:
            foxglove = importlib.import_module("foxglove")
            websocket = importlib.import_module("foxglove.websocket")
        except ImportError as error:
            raise not_installed("foxglove-sdk") from error
        self._host = host
        self._subscribed: SimpleQueue[str] = SimpleQueue()
        self._last: dict[str, tuple[bytes, int]] = {}
        self._context = context = foxglove.Context()  # a separate context: its channels close when it is released
        self._channels = {
            topic.name: foxglove.Channel(
                topic.name,
                schema=foxglove.Schema(name=topic.type_name, encoding="ros2msg", data=topic.definition.encode()),
                message_encoding="cdr",
                context=context,
            )
            for topic in topics
        }
        hidden = f"127.{secrets.randbelow(256)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"
        self._server = foxglove.start_server(
            name="litsim",
            host=hidden,  # one of 2^24, with one of 2^15 ports: no page in a browser finds that
            port=0,
            capabilities=[websocket.Capability.Time],
            server_listener=_listener(websocket, self._subscribed),
            supported_encodings=["cdr"],
            message_backlog_size=BACKLOG,
            context=context,
        )
        try:
            self._gate = OriginGate(host, port, f"ws://{hidden}:{self._server.port}", origins)
        except (OSError, ValueError) as error:
            self._server.stop()
            taken = f"; give another --port ({errno.errorcode[errno.EADDRINUSE]})" if "in use" in str(error) else ""
            raise InputError(f"--foxglove: cannot listen on {host}:{port}: {error}{taken}") from error

    @property
    def url(self) -> str:
        """The URL for clients."""
        return f"ws://{self._host}:{self._gate.port}"

    def wants(self, topic: str) -> bool:
        """Returns whether a client has subscribed to `topic`."""
        return bool(self._channels[topic].has_sinks())

    def send(self, topic: str, cdr: bytes, time_ns: int) -> None:
        """Send a serialised message at a simulation time [ns]."""
        self._last[topic] = (cdr, time_ns)
        self._channels[topic].log(cdr, log_time=time_ns)

    def time(self, time_ns: int) -> None:
        """Send the simulation time [ns]."""
        self._server.broadcast_time(time_ns)

    def welcome(self) -> None:
        """Send the last messages to clients that have subscribed since the last call."""
        names = set()
        try:
            while True:
                names.add(self._subscribed.get_nowait())
        except Empty:
            pass
        for name in sorted(names & self._last.keys()):
            cdr, time_ns = self._last[name]
            self._channels[name].log(cdr, log_time=time_ns)

    def close(self) -> None:
        """Disconnect all clients and stop listening."""
        self._gate.close()
        self._server.stop()


def _listener(websocket: Any, subscribed: SimpleQueue[str]) -> Any:
    class Listener(websocket.ServerListener):
        def on_subscribe(self, client: Any, channel: Any) -> None:  # noqa: ARG002 - as the SDK has it; in its thread
            subscribed.put(channel.topic)

    return Listener()
