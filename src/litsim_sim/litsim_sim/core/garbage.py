"""Python's garbage collector, kept from where it costs much and finds nothing."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_collection() -> Iterator[None]:
    """Nothing is collected meanwhile: for what makes many objects that stay, as imports and loading of kernels do.

    The collector, which goes through them again and again, takes a quarter of such a time.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


@contextmanager
def spared_from_collection() -> Iterator[None]:
    """What there is by now is left alone meanwhile: for a run, which makes objects of its own and drops them.

    Going through all libraries, the scenario and the cores takes as long as several steps, and finds nothing.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
