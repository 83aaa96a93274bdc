"""A gate before a WebSocket server that does not check who connects: only native programs and known pages pass.

A page in a user's browser may open a WebSocket to any address of this machine. Browsers say of which site the page is
(header `Origin`), and which name it has looked up (`Host`), which a page can make resolve to this machine.
"""

from __future__ import annotations

import importlib
import ipaddress
import socket
from collections.abc import Collection
from http import HTTPStatus
from threading import Thread
from typing import Any
from urllib.parse import urlsplit

from litsim_sim.core.errors import not_installed

ORIGINS = ("https://app.foxglove.dev", "file://")  # the site; programs that are a browser, such as Foxglove's
SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")


class OriginGate:
    """Listens on an address, and passes the messages of those who may connect on to a server, and back.

    Args:
        host, port: to listen on; port 0 is a free one.
        behind: URL of the server.
        origins: of pages that may connect, beside those of this machine and :data:`ORIGINS`.

    Raises:
        InputError: websockets is not installed.
        OSError: the address is not available.
    """

    def __init__(self, host: str, port: int, behind: str, origins: Collection[str] = ()) -> None:
        try:
            self._client = importlib.import_module("websockets.sync.client")
            server = importlib.import_module("websockets.sync.server")
        except ImportError as error:
            raise not_installed("websockets") from error
        self._behind, self._origins = behind, {*ORIGINS, *origins}
        self._how: dict[str, Any] = {"compression": None, "max_size": None}
        self._server = server.serve(
            self._pass_on, host, port, subprotocols=SUBPROTOCOLS, process_request=self._refuse, **self._how
        )
        Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self._server.socket.getsockname()[1])

    def close(self) -> None:
        """Stop listening; those who are connected stay so until the server behind closes."""
        self._server.shutdown()

    def _refuse(self, connection: Any, request: Any) -> Any:
        """Returns the answer that refuses `connection`; None if it may connect."""
        origin, host = request.headers.get("Origin"), urlsplit(f"//{request.headers.get('Host', '')}").hostname or ""
        if origin is not None and origin not in self._origins and not _is_here(urlsplit(origin).hostname or ""):
            return connection.respond(
                HTTPStatus.FORBIDDEN, f"pages of {origin[:200]} may not read this run: name it with --allow-origin\n"
            )
        if not (_address(host) or host in ("localhost", socket.gethostname().lower())):
            return connection.respond(
                HTTPStatus.FORBIDDEN, f"{host[:200]} is no name of this machine: use its address\n"
            )
        return None

    def _pass_on(self, connection: Any) -> None:
        with self._client.connect(self._behind, subprotocols=[connection.subprotocol], **self._how) as server:
            Thread(target=_copy, args=(connection, server), daemon=True).start()
            _copy(server, connection)


def _copy(source: Any, target: Any) -> None:
    """Passes messages on until one side closes, then closes the other."""
    closed = importlib.import_module("websockets.exceptions").ConnectionClosed
    try:
        for message in source:
            target.send(message)
    except closed:
        pass
    finally:
        target.close()


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Returns the address that `host` is; None if it is a name."""
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def _is_here(host: str) -> bool:
    """Returns whether a page of `host` is served by this machine."""
    address = _address(host)
    return host == "localhost" or (address is not None and address.is_loopback)
