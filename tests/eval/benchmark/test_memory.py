"""What a benchmark says of the memory of a run: figures from looks that are made up, and looks at real processes."""

import os
import subprocess
import sys

import numpy as np
import pytest

from litsim_eval.benchmark.memory import Memory, children, memory_rows, resident_mb


def test_growth_is_that_of_the_run_once_it_has_settled() -> None:
    share = np.linspace(0.0, 1.0, 101)
    leaks = Memory(share.tolist(), np.where(share < 0.2, 300.0 * share, 60.0 + 20.0 * share).tolist())
    assert leaks.slope(minutes=10.0) == pytest.approx(2.0), "20 MB in 10 minutes"
    assert (leaks.at(0.0), leaks.at(1.0)) == (0.0, 80.0)
    assert list(memory_rows({"bridge": leaks}, 10.0)) == [["bridge", "0.0", "65.0", "80.0", "+2.00"]]


def test_memory_that_stays_does_not_grow() -> None:
    assert Memory([0.0, 0.5, 1.0], [200.0, 210.0, 210.0]).slope(10.0) == pytest.approx(0.0, abs=1e-9)


def test_the_nodes_of_a_launcher_are_found_by_name_and_looked_at() -> None:
    program = "import sys, time; held = bytearray(50_000_000); print('ready', flush=True); sys.stdin.read()"
    node = subprocess.Popen(
        [sys.executable, "-c", program, "/lib/litsim_sim/bridge"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    other = subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert node.stdout is not None and node.stdout.readline() == "ready\n"
        assert children(os.getpid()) == {"bridge": node.pid}
        assert resident_mb(node.pid) > 50.0
    finally:
        for process in (node, other):
            process.communicate("")
    assert resident_mb(node.pid) == 0.0, "it has ended"
