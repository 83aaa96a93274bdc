"""Services that have to be called before a stack drives, one after the other, until each has agreed. Without ROS."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

RETRY_S = 1.0  # [s] between two attempts
PATIENCE_S = 20.0  # [s] for a response
INVALID_STATE = 1  # code of a response to a route: there is one already

SET_ROUTE, CLEAR_ROUTE = "set_route", "clear_route"


@dataclass(frozen=True)
class Call:
    """A service to be called.

    Attributes:
        service: its name.
        is_there: whether it is served.
        call: calls it; returns the future of the response, as rclpy does.
    """

    service: str
    is_there: Callable[[], bool]
    call: Callable[[], Any]


class StartUp:
    """Calls services in order; each is called again until it says that it has succeeded.

    Attributes:
        waiting: what it waits for, for the user; empty once all have succeeded.
    """

    def __init__(self, calls: Mapping[str, Call]) -> None:
        """`calls` by their purpose; that to clear a route is only made if there is one already."""
        self._calls = calls
        self._left = [name for name in calls if name != CLEAR_ROUTE]
        self._future: Any = None
        self._asked, self._next = 0.0, 0.0
        self.waiting = f"service {calls[self._left[0]].service}" if self._left else ""

    @property
    def done(self) -> bool:
        """Whether all have succeeded."""
        return not self._left

    def poll(self, now: float) -> None:
        """Go on as far as possible without waiting; `now` is in seconds of any clock."""
        if self._left and self._future is None and now >= self._next:
            call = self._calls[self._left[0]]
            if call.is_there():
                self._future, self._asked = call.call(), now
                self.waiting = f"the response of {call.service}"
            else:
                self.waiting, self._next = f"service {call.service}", now + 0.1 * RETRY_S
        elif self._future is not None and self._future.done():
            self._take(self._future.result(), now)
        elif self._future is not None and now > self._asked + PATIENCE_S:
            self._future = None

    def _take(self, response: Any, now: float) -> None:
        """Take a response: go on to the next service, or try again."""
        name, self._future = self._left[0], None
        status = response.status
        if status.success or name == CLEAR_ROUTE:
            del self._left[0]
            self.waiting = ""
            return
        self.waiting = f"{self._calls[name].service}: {status.message or 'it refuses'} (code {status.code})"
        self._next = now + RETRY_S
        if name == SET_ROUTE and status.code == INVALID_STATE and CLEAR_ROUTE in self._calls:
            self._left.insert(0, CLEAR_ROUTE)
