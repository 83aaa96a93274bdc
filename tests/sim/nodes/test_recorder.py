"""How the recorder gives way to the stages that others wait for."""

from __future__ import annotations

import subprocess
import sys

from litsim_sim.nodes.recorder import NICENESS

PROGRAM = """
import os, threading
from litsim_sim.nodes.recorder import give_way
before = os.nice(0)
give_way()
threading.Thread(target=lambda: print(os.nice(0) - before)).start()
"""


def test_it_and_the_threads_that_it_starts_let_others_go_first() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=120, check=True)
    assert int(done.stdout) == NICENESS
