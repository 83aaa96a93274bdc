"""A node of a test, in a context and a domain of its own."""

from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from patience import wait_for


class Observer:
    """Listens in a domain, and asks services for things; a context manager."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(type(self).__name__.lower(), context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self.node.destroy_node()
        self.context.try_shutdown()

    def wait(self, what: str, done: Callable[[], object]) -> None:
        """Serve messages until `done`."""
        wait_for(what, done, lambda: self.executor.spin_once(timeout_sec=0.05))

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """The response of a service."""
        client = self.node.create_client(kind, name)
        self.wait(name, client.service_is_ready)
        future = client.call_async(request)
        self.wait(f"a response of {name}", future.done)
        return future.result()
