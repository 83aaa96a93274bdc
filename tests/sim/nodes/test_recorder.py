"""How the recorder gives way to the stages that others wait for."""

from __future__ import annotations

import os
import subprocess
import sys

from litsim_sim.nodes.recorder import NICENESS

PROGRAM = """
import os, sys, threading
from litsim_sim.nodes.recorder import give_way
os.sched_setscheduler(0, int(sys.argv[1]), os.sched_param(0))
before = os.nice(0)
give_way()
threading.Thread(target=lambda: print(os.sched_getscheduler(threading.get_native_id()), os.nice(0) - before)).start()
"""


def scheduled(policy: int) -> list[int]:
    """Scheduling policy of a thread of a process that gives way, from `policy` on, and what its niceness rises by."""
    words = [sys.executable, "-c", PROGRAM, str(policy)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    return [int(word) for word in done.stdout.split()]


def test_a_thread_that_it_starts_does_not_interrupt_others_when_it_is_woken() -> None:
    assert scheduled(os.SCHED_OTHER) == [os.SCHED_BATCH, NICENESS]
    assert scheduled(os.SCHED_IDLE) == [os.SCHED_IDLE, NICENESS], "what the user has chosen stays"
