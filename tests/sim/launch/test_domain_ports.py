"""Whether somebody is in a domain, by the sockets of this machine."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import domain_coordinator
import pytest

from litsim_sim.launch.domain_ports import DOMAIN_PORTS, FIRST_PORT, is_known_empty
from litsim_sim.launch.middleware import PEERS, PROFILES, RANGE

HERE = {RANGE: "LOCALHOST"}
JOIN = """
import sys
import rclpy
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("somebody")
print("there", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def domain() -> Iterator[int]:
    """A domain that nobody is in."""
    with domain_coordinator.domain_id() as reserved:
        yield reserved


def test_nobody_is_there_until_somebody_has_a_socket(domain: int) -> None:
    first = FIRST_PORT + DOMAIN_PORTS * domain
    assert is_known_empty(domain, HERE)
    for port in (first + 10, first + DOMAIN_PORTS - 1):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
            somebody.bind(("127.0.0.1", port))
            assert not is_known_empty(domain, HERE)
        assert is_known_empty(domain, HERE)


@pytest.mark.parametrize("discovery", ["LOCALHOST", "SUBNET", "SYSTEM_DEFAULT"])
def test_a_node_is_somebody(domain: int, discovery: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RANGE, discovery)
    monkeypatch.delenv(PROFILES[0], raising=False)
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", JOIN, str(domain)], stdin=pipe, stdout=pipe, text=True) as node:
        assert node.stdout is not None
        assert node.stdout.readline() == "there\n"
        assert not is_known_empty(domain, HERE)
        node.communicate()
    assert is_known_empty(domain, HERE)


def test_somebody_at_the_ports_of_the_next_domain_is_nobody(domain: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
        somebody.bind(("127.0.0.1", FIRST_PORT + DOMAIN_PORTS * (domain + 1)))
        assert is_known_empty(domain, HERE)


@pytest.mark.parametrize(
    "environment",
    [
        {RANGE: "SUBNET"},
        {RANGE: "LOCALHOST", PEERS: "192.168.0.7"},
        {RANGE: "LOCALHOST", PROFILES[0]: "own.xml"},
        {RANGE: "LOCALHOST", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
    ],
)
def test_of_nodes_that_may_hear_others_nothing_is_certain(domain: int, environment: dict[str, str]) -> None:
    assert is_known_empty(domain, HERE)
    assert not is_known_empty(domain, environment)


def test_without_a_list_that_holds_every_socket_nothing_is_certain(domain: int, tmp_path: Path) -> None:
    (tmp_path / "empty").write_text("  sl  local_address rem_address\n")
    assert not is_known_empty(domain, HERE, (tmp_path / "empty", tmp_path / "absent"))
