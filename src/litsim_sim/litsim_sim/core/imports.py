"""Imports that libraries make just in case, left out where they take long and nobody here uses what they bring."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast


@contextmanager
def left_out(*modules: str) -> Iterator[None]:
    """Imports of `modules` fail meanwhile, but for those that are there already: for libraries that do without them."""
    absent = [name for name in modules if name not in sys.modules]
    sys.modules.update(dict.fromkeys(absent, cast(Any, None)))
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]
