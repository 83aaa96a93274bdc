"""Waiting in tests for what takes a moment."""

import time
from collections.abc import Callable

PATIENCE_S = 120.0  # only a failing test waits so long


def pause() -> None:
    """Let others work for a moment."""
    time.sleep(0.02)


def wait_for(what: str, done: Callable[[], object], between: Callable[[], object] = pause) -> None:
    """Wait until `done`, with a pause or what else is to be done `between` two looks; `what` says for what."""
    end = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < end, f"waited {PATIENCE_S:g} s for {what}"
        between()
