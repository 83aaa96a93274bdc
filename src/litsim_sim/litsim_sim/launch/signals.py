"""Signals to a process that starts others, and to those that it starts."""

from __future__ import annotations

import ctypes
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from litsim_sim.launch.supervisor import DIE_WITH_PARENT

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals by which a user ends a program."""

_LIBC = ctypes.CDLL(None)


def end_with_parent() -> None:
    """Make this process end when the thread that started it ends, however that ends."""
    _LIBC.prctl(DIE_WITH_PARENT, signal.SIGTERM)


def begin_child() -> None:
    """In a child before its program starts: end when the launcher is gone; hear signals."""
    end_with_parent()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def reset_handlers() -> None:
    """Handle signals as Python does when it starts, whatever the process that this one is a copy of does."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in set(SIGNALS) - {signal.SIGINT}:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup holds SIGHUP back
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def signals_deferred() -> Iterator[None]:
    """Defer signals to the end of the context, so that a process being started is known to the code that ends it.

    They are blocked in this thread, since Python swallows exceptions raised by handlers during a fork. Threads of
    libraries may still take them, whereupon Python calls their handlers here; so the handlers are deferred, too.
    """
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number, handler in before.items():
        if callable(handler):
            signal.signal(number, lambda number, _: came.append(number))
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        for number, handler in before.items():
            if callable(handler):
                signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        if came:
            signal.raise_signal(came[0])


def without_interrupts(action: Callable[[], object]) -> None:
    """Run `action` while Ctrl-C and other ending signals are ignored, so that no orphans are left."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in SIGNALS}
    try:
        action()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
