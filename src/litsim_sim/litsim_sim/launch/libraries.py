"""Work done for a launcher while Python does something else: linking libraries, and querying other programs.

libsumo depends on a hundred libraries; linking them takes 0.13 s. An import would block Python for that time; a call of
the linker does not. Libraries loaded in a process are loaded in its copies, too.
"""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

SUMO, SUMO_FILE = "libsumo", "_libsumo*.so"
LINKED_BEFORE = ("statistics", "safetensors")
"""Modules with libraries that the stages need; imported first, as the linker loads one library after the other."""


@contextmanager
def meanwhile(action: Callable[[], object]) -> Iterator[None]:
    """Run `action` in a thread during the context, and wait for it at the end."""
    thread = threading.Thread(target=action)
    thread.start()
    try:
        yield
    finally:
        thread.join()


@contextmanager
def loading_sumo() -> Iterator[None]:
    """Load SUMO's shared library during the context, in another thread, without importing it.

    If it cannot be loaded, the later import says why.
    """
    found = find_spec(SUMO)
    paths = [
        path for folder in (found and found.submodule_search_locations) or () for path in Path(folder).glob(SUMO_FILE)
    ]
    if not paths:
        yield
        return
    for module in filter(find_spec, LINKED_BEFORE):
        import_module(module)
    with meanwhile(partial(_link, paths[0])):
        yield


def _link(path: Path) -> None:
    """Let the linker load a library as an import would; unlike an import, a foreign call does not block Python."""
    link = ctypes.CDLL(None).dlopen
    link.argtypes, link.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
    link(os.fsencode(path), os.RTLD_NOW)
