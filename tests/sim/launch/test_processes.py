"""What the processes of a graph are started with."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from litsim_sim.launch.middleware import ENCLAVE, RANGE, SECURITY
from litsim_sim.launch.processes import STACK, Graph


def environment(folder: Path) -> dict[str, str]:
    """What a node that is started by the launcher finds in its environment."""
    folder.mkdir()
    program = folder / "node"
    program.write_text("#!/bin/sh\nenv\n")
    program.chmod(0o755)
    graph = Graph(folder / "out", 7)
    graph.start("node", program, {})
    try:
        graph.children["node"].process.wait(60.0)
    finally:
        graph.stop()
    return variables(graph.children["node"].log)


def variables(log: Path) -> dict[str, str]:
    """What ``env`` has said."""
    return dict(line.split("=", 1) for line in log.read_text().splitlines() if "=" in line)


def test_nodes_stay_on_this_machine_unless_the_user_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(RANGE, raising=False)
    found = environment(tmp_path / "usual")
    assert (found["ROS_DOMAIN_ID"], found[RANGE]) == ("7", "LOCALHOST")
    monkeypatch.setenv(RANGE, "SUBNET")
    assert environment(tmp_path / "chosen")[RANGE] == "SUBNET"


def test_a_stack_is_in_an_enclave_of_its_own_where_runs_are_secured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(ENCLAVE, raising=False)
    found = {}
    for secured in ("false", "true"):
        monkeypatch.setenv(SECURITY, secured)
        graph = Graph(tmp_path / secured, 7)
        graph.start_stack(["env"])
        try:
            graph.children[STACK].process.wait(60.0)
        finally:
            graph.stop()
        found[secured] = variables(graph.children[STACK].log)
    assert ENCLAVE not in found["false"]
    assert found["true"][ENCLAVE] == "/litsim/ads"


HELD_BACK = """
import os, signal, threading, time
from litsim_sim.launch.processes import held_back

signal.signal(signal.SIGINT, signal.default_int_handler)
threading.Thread(target=time.sleep, args=(600,), daemon=True).start()  # takes what this thread does not
try:
    with held_back():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.5)
        print("started")
    print("went on")
except KeyboardInterrupt:
    print("interrupted")
os.kill(os.getpid(), signal.SIGINT)
time.sleep(60)
"""


def test_an_interrupt_waits_until_what_is_being_started_is_known() -> None:
    done = subprocess.run([sys.executable, "-c", HELD_BACK], capture_output=True, text=True, timeout=100, check=False)
    assert done.stdout.splitlines() == ["started", "interrupted"]
    assert done.stderr.splitlines()[-1] == "KeyboardInterrupt"
