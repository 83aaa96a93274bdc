"""Adapters: kinds of stacks that drive the ego through a program of their own, by which the launcher starts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from litsim_sim.core import plugins
from litsim_sim.launch.nodes import find_executable


@dataclass(frozen=True)
class EgoAdapter:
    """A program between the ego port and a kind of stack, an object of the entry points ``litsim.adapters``.

    It publishes /clock and /tf in the bridge's place, answers on the ego port, and ends once the run is over. It starts
    the command that follows ``--`` among its arguments, if there is one.

    Attributes:
        package, executable: of the program.
        arguments: its arguments.
        record: topics of the stack that are recorded, beside those that the user names.
        ready_s: time limit for the answer to step 0 [s], unless it is set.
    """

    package: str
    executable: str
    arguments: tuple[str, ...] = ()
    record: tuple[str, ...] = ()
    ready_s: float = 60.0

    def command(self, stack: Sequence[str]) -> list[str]:
        """Returns the command that starts program and `stack`; raises InputError as :func:`find_executable`."""
        program = str(find_executable(self.package, self.executable))
        return [program, *self.arguments, *(["--", *stack] if stack else [])]


def adapter_names() -> tuple[str, ...]:
    """Names of the installed adapters."""
    return plugins.names(plugins.ADAPTERS)


def adapter_of(ego: str) -> EgoAdapter | None:
    """Returns the adapter called `ego`; None if it is no adapter. Raises InputError if it cannot be imported."""
    if ego not in adapter_names():
        return None
    adapter: EgoAdapter = plugins.load(plugins.ADAPTERS, ego)
    return adapter
