"""Shared libraries of the nodes that take long to load, loaded while Python does something else.

libsumo brings a hundred libraries along, whose linking takes 0.13 s. An import would hold Python up meanwhile; the
linker alone does not. What it has loaded in a process, copies of the process have, too.
"""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

SUMO, SUMO_FILE = "libsumo", "_libsumo*.so"


@contextmanager
def loading_sumo() -> Iterator[None]:
    """SUMO's shared library is loaded meanwhile, on another core, and is there afterwards; it is imported by nobody.

    One that cannot be loaded is left to the import of it, which says why.
    """
    found = find_spec(SUMO)
    paths = [
        path for folder in (found and found.submodule_search_locations) or () for path in Path(folder).glob(SUMO_FILE)
    ]
    thread = threading.Thread(target=_link, args=paths[:1])
    if paths:
        thread.start()
    try:
        yield
    finally:
        if paths:
            thread.join()


def _link(path: Path) -> None:
    """Have the linker load a library as an import of it would; unlike an import, a foreign call lets Python go on."""
    link = ctypes.CDLL(None).dlopen
    link.argtypes, link.restype = (ctypes.c_char_p, ctypes.c_int), ctypes.c_void_p
    link(os.fsencode(path), os.RTLD_NOW)
