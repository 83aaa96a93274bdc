"""Which domain a graph uses, that no other is on it, and whether somebody is in it by the sockets of this machine."""

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import domain_coordinator
import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.launch.domain import DOMAIN_PORTS, FIRST_PORT, HOLDER, graph_domain, held_domain, is_known_empty
from litsim_sim.launch.middleware import PEERS, PROFILES, RANGE

HOLD = """
import sys
from litsim_sim.launch.domain import held_domain
try:
    with held_domain(7) as domain:
        print("held", flush=True)
        sys.stdin.read()
except Exception as error:
    print(error, flush=True)
"""

HERE = {RANGE: "LOCALHOST"}
JOIN = """
import sys
import rclpy
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("somebody")
print("there", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Locks of this test alone."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


def another(**environment: str) -> subprocess.Popen[str]:
    """Another process that holds domain 7, or says why it cannot."""
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-c", HOLD], stdin=pipe, stdout=pipe, text=True, env=os.environ | environment
    )


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_of_two_graphs_on_a_domain_the_second_is_refused_until_the_first_has_ended() -> None:
    first = another()
    assert said(first) == "held"
    second = another()
    assert said(second) == (
        f"ROS_DOMAIN_ID 7: another run of yours is on there (process {first.pid}); choose another domain, or wait for "
        "the end of that run"
    )
    second.communicate()
    first.kill()  # however it ends
    first.communicate()
    with graph_domain(7, reserve=False) as domain:
        assert domain == 7


def test_a_graph_that_is_just_ending_is_waited_for() -> None:
    first = another()
    assert said(first) == "held"
    end = threading.Timer(0.3, first.kill)
    end.start()
    with held_domain(7) as domain:
        assert domain == 7
    end.join()
    assert first.wait() < 0, "it held the domain until then"


def test_who_was_started_by_the_holder_is_let_in() -> None:
    with held_domain(7):
        mine = another(**{HOLDER: str(os.getpid())})
        assert said(mine) == "held"
        mine.communicate()
        assert said(another(**{HOLDER: "1"})).startswith("ROS_DOMAIN_ID 7: another run of yours is on there")


def test_a_domain_that_was_chosen_by_another_graph_is_none_that_is_free() -> None:
    with graph_domain(None, reserve=True) as first, graph_domain(None, reserve=True) as second:
        assert first != second


def test_a_domain_that_somebody_is_in_is_none_that_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    offered = iter([41, 42])
    monkeypatch.setattr(domain_coordinator, "domain_id", lambda: nullcontext(next(offered)))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
        somebody.bind(("127.0.0.1", FIRST_PORT + DOMAIN_PORTS * 41 + 10))
        with graph_domain(None, reserve=True) as domain:
            assert domain == 42


@pytest.mark.parametrize("domain", ["-1", "233", "one"])
def test_there_is_no_such_domain(domain: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(InputError, match=f"ROS_DOMAIN_ID is '{domain}', expected 0 to 232"):
        graph_domain(None, reserve=True)


def test_locks_that_cannot_be_written_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    with pytest.raises(InputError, match="the lock of ROS_DOMAIN_ID 7 cannot be had: Not a directory"), held_domain(7):
        pass


def test_a_lock_that_others_could_have_put_there_is_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Others may write into the folder of temporary files: what they put there is neither written nor waited for."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = tmp_path / f"litsim-{os.getuid()}"
    victim, lock = tmp_path / "victim", folder / "domain_7.lock"
    victim.write_text("precious")

    def refused(*, match: str) -> None:
        with pytest.raises(InputError, match=f"cannot be had: .*{match}"), held_domain(7):
            pass
        assert victim.read_text() == "precious"

    folder.symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    (tmp_path / "elsewhere").mkdir()
    refused(match="not a folder of yours alone")
    folder.unlink()
    folder.mkdir()
    folder.chmod(0o777)
    refused(match="not a folder of yours alone")
    folder.chmod(0o700)
    lock.symlink_to(victim)
    refused(match="symbolic link")
    lock.unlink()
    os.link(victim, lock)
    refused(match="not a file of yours alone")
    lock.unlink()
    os.mkfifo(lock)
    refused(match="not a file of yours alone")
    lock.unlink()
    lock.mkdir()
    refused(match="directory")
    lock.rmdir()
    with held_domain(7):
        assert lock.is_file()


def test_errors_of_the_run_are_its_own() -> None:
    with pytest.raises(OSError, match="disk"), graph_domain(None, reserve=True):
        raise OSError("no disk")


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A domain that nobody is in, not even a process that is just ending."""
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    with graph_domain(None, reserve=True) as reserved:
        yield reserved


def test_nobody_is_there_until_somebody_has_a_socket(domain: int) -> None:
    first = FIRST_PORT + DOMAIN_PORTS * domain
    assert is_known_empty(domain, HERE)
    for port in (first + 10, first + DOMAIN_PORTS - 1):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
            somebody.bind(("127.0.0.1", port))
            assert not is_known_empty(domain, HERE)
        assert is_known_empty(domain, HERE)


@pytest.mark.parametrize("discovery", ["LOCALHOST", "SUBNET"])
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
