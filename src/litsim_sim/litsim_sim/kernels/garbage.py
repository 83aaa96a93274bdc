"""Control of Python's garbage collector where it is expensive and finds nothing."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_collection() -> Iterator[None]:
    """Disable collection in the context, for code that makes many lasting objects, such as imports.

    Repeated passes over these objects would take a quarter of the time of imports and of loading of kernels.
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
    """Exempt all existing objects from collection in the context, for a run.

    A pass over all libraries, the scenario and the cores takes as long as several steps, and finds nothing.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
