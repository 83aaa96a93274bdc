"""Sockets of a node that stays on this machine."""

import ipaddress
import json
import os
import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from litsim_sim.launch.middleware import RANGE
from litsim_sim.launch.processes import Graph as Launched
from litsim_sim.launch.supervisor import descendants
from patience import wait_for

STACK = "import rclpy; rclpy.init(); rclpy.spin(rclpy.create_node('stack'))"
ALONE = Path(__file__).with_name("programs") / "alone.py"
NOT_ALLOWED = 77  # its exit status where the system permits no network of one's own


def addresses(pid: int) -> set[str]:
    """Local addresses of the UDP sockets of a process."""
    own = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):
            own.update(re.findall(r"socket:\[(\d+)\]", str(link.readlink())))
    rows = [line.split() for line in Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]]
    raw = [int(row[1].split(":")[0], 16).to_bytes(4, sys.byteorder) for row in rows if row[9] in own]
    return {str(ipaddress.IPv4Address(each)) for each in raw}


def test_a_node_listens_on_the_loopback_interface_alone_and_leaves_no_shared_memory(graph: Any) -> None:
    node = graph.start_node("litsim_sim", "live")
    wait_for("its sockets", lambda: addresses(node.pid))
    assert addresses(node.pid) == {"127.0.0.1"}
    maps = Path(f"/proc/{node.pid}/maps").read_text() if os.access(f"/proc/{node.pid}/maps", os.R_OK) else ""
    assert "fastrtps" in maps  # it is Fast DDS
    assert "/dev/shm/fastrtps" not in maps


@pytest.mark.parametrize(("chosen", "alone"), [("LOCALHOST", True), ("SUBNET", False)])
def test_a_stack_that_the_launcher_starts_stays_where_its_nodes_stay(
    graph: Any, monkeypatch: pytest.MonkeyPatch, chosen: str, alone: bool
) -> None:
    monkeypatch.setenv(RANGE, chosen)
    made = Launched(graph.folder, graph.domain)
    try:
        made.start_stack([sys.executable, "-c", STACK])
        supervisor = made.children["ads"].process.pid
        wait_for("its sockets", lambda: any(map(addresses, descendants(supervisor))))
        (stack,) = descendants(supervisor)
        assert (addresses(stack) == {"127.0.0.1"}) == alone
    finally:
        made.stop()


def test_a_run_needs_no_network(graph: Any) -> None:
    words = ("--scenario", graph.scenario(), "--policy", "replay", "--out", graph.folder / "run")
    done = graph.finish(graph.start_launch(*words, through=(sys.executable, ALONE)))
    if done.returncode == NOT_ALLOWED:
        pytest.skip(f"no network of one's own: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    assert json.loads((graph.folder / "run/metrics.json").read_text())["valid"]
