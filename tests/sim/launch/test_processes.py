"""What the processes of a graph are started with."""

from __future__ import annotations

from pathlib import Path

import pytest

from litsim_sim.launch.middleware import RANGE
from litsim_sim.launch.processes import Graph


def environment(folder: Path) -> dict[str, str]:
    """What a node that is started by the launcher finds in its environment."""
    folder.mkdir()
    program = folder / "node"
    program.write_text("#!/bin/sh\nenv\n")
    program.chmod(0o755)
    graph = Graph(folder / "out", 7)
    graph.start("node", program, {})
    try:
        graph.children["node"].process.wait(10.0)
    finally:
        graph.stop()
    lines = graph.children["node"].log.read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line)


def test_nodes_stay_on_this_machine_unless_the_user_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(RANGE, raising=False)
    found = environment(tmp_path / "usual")
    assert (found["ROS_DOMAIN_ID"], found[RANGE]) == ("7", "LOCALHOST")
    monkeypatch.setenv(RANGE, "SUBNET")
    assert environment(tmp_path / "chosen")[RANGE] == "SUBNET"
