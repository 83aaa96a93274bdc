"""Shared libraries that are loaded while Python does something else."""

from __future__ import annotations

import subprocess
import sys
import threading

from litsim_sim.launch import libraries

LOADED = """
import sys
from pathlib import Path
from litsim_sim.launch import libraries
if sys.argv[1:]:
    libraries.SUMO = sys.argv[1]
with libraries.loading_sumo():
    pass
print("_libsumo" in Path("/proc/self/maps").read_text(), "libsumo" in sys.modules)
"""


def loaded(*arguments: str) -> list[str]:
    """Whether the library is there, and whether it was imported."""
    run = subprocess.run([sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, check=True)
    return run.stdout.split()


def test_sumo_is_loaded_but_not_imported() -> None:
    assert loaded() == ["True", "False"]


def test_without_sumo_nothing_happens() -> None:
    assert loaded("no_such_sumo") == ["False", "False"]


def test_what_is_done_meanwhile_is_done_afterwards() -> None:
    done: list[int] = []
    with libraries.meanwhile(lambda: done.append(threading.get_ident())):
        pass
    assert done and done != [threading.get_ident()]
