"""How the end of a process is told: by its exit status, and by what it said last."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from litsim_sim.launch import child as child_module
from litsim_sim.launch.child import Child


@pytest.mark.parametrize(
    ("log", "code", "expected"),
    [
        ("error: no net\n", 2, "node ego ended with exit status 2: no net"),
        ("\nout of luck\n\n", 1, "node ego ended with exit status 1: out of luck"),
        ("", 1, "node ego ended with exit status 1"),
        ("out of luck\n", 0, "node ego ended with exit status 0"),
        ("out of luck\n", -9, "node ego was ended by SIGKILL"),
        ("", 130, "node ego was interrupted"),
        ("\x1b[31mout\tof\0 luck\x1b[0m\n\x1b[0m\n", 1, "node ego ended with exit status 1: out of luck"),
        pytest.param("x" * 10**6, 1, f"node ego ended with exit status 1: {'x' * 1000} …", id="a long line"),
    ],
)
def test_the_last_word_of_a_node_is_told_where_it_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, log: str, code: int, expected: str
) -> None:
    path = tmp_path / "ego.log"
    path.write_text(log)
    end = f"import os, sys; os.kill(os.getpid(), {-code}) if {code} < 0 else sys.exit({code})"
    with subprocess.Popen([sys.executable, "-c", end], text=True) as process:
        process.wait()
    child = Child("ego", process, path)
    assert child.obituary() == expected
    monkeypatch.setattr(child_module.shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    full = f": it could say nothing, as the disk of {tmp_path} is full"
    assert child.obituary() == expected + (full if not log else "")
