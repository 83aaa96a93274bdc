"""What the processes of a graph are started with."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from litsim_sim.launch.processes import DISCOVERY, PROFILES, Graph


def environment(folder: Path) -> dict[str, str]:
    """What a node that is started by the launcher finds in its environment."""
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


def test_nodes_that_are_started_together_announce_themselves_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in PROFILES:
        monkeypatch.delenv(name, raising=False)
    found = environment(tmp_path)
    assert found["ROS_DOMAIN_ID"] == "7"
    path = Path(found[PROFILES[0]])
    assert path == DISCOVERY
    (profile,) = ET.parse(path).getroot()
    assert profile.attrib["is_default_profile"] == "true", "else no node would use it"


@pytest.mark.parametrize("name", PROFILES)
def test_settings_of_the_user_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    for other in PROFILES:
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(name, "/mine.xml")
    found = environment(tmp_path)
    assert {other: found.get(other) for other in PROFILES} == dict.fromkeys(PROFILES) | {name: "/mine.xml"}
