"""The supervisor of a stack: it ends as the command does, and leaves nothing of it behind."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from litsim_sim.launch import supervisor
from patience import PATIENCE_S, wait_for


@pytest.fixture
def keep() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []

    def start(*command: str) -> subprocess.Popen[str]:
        words = [sys.executable, "-I", "-S", supervisor.__file__, *command]
        started.append(subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        for each in supervisor.descendants(process.pid):
            os.kill(each, signal.SIGKILL)
        process.kill()
        process.communicate()


def lives(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def parent(process: int) -> int:
    return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])


@pytest.mark.parametrize(
    ("script", "status"), [("exit 0", 0), ("exit 3", 3), ("kill -SEGV $$", -signal.SIGSEGV), ("kill -9 $$", -9)]
)
def test_it_ends_as_the_command_does(keep: Callable[..., subprocess.Popen[str]], script: str, status: int) -> None:
    assert keep("sh", "-c", script).wait(PATIENCE_S) == status


def test_what_cannot_be_started_is_said(keep: Callable[..., subprocess.Popen[str]], tmp_path: Path) -> None:
    process = keep(str(tmp_path / "no_stack"))
    said = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == supervisor.NOT_FOUND
    assert said == f"error: {tmp_path}/no_stack: cannot be started: No such file or directory\n"


def test_of_too_much_output_the_beginning_and_the_end_are_kept(tmp_path: Path) -> None:
    script = (
        "echo begin; yes | head -c 40000000; sleep 0.5; echo still there; yes | head -c 20000000; sleep 0.5; echo end"
    )
    log = tmp_path / "ads.log"
    words = [sys.executable, "-I", "-S", supervisor.__file__, "sh", "-c", script]
    with log.open("a") as stream:
        assert subprocess.run(words, stdout=stream, stderr=stream, check=False, timeout=PATIENCE_S).returncode == 0
    text = log.read_text()
    assert supervisor.HEAD < len(text) <= supervisor.LOG_MAX
    assert text.startswith("begin\n") and text.endswith("y\nend\n")
    assert "bytes of output are left out here: a log has at most 16777216]\n" in text


def test_what_the_command_has_left_behind_is_ended(keep: Callable[..., subprocess.Popen[str]], tmp_path: Path) -> None:
    """One in a session of its own, as daemons are, and one that does not listen to SIGTERM."""
    deaf, go = tmp_path / "deaf", tmp_path / "go"
    leave = f"setsid sleep 600 & (trap '' TERM; touch {deaf}; sleep 600) & echo $!"
    process = keep("sh", "-c", f"{leave}; until [ -e {deaf} ] && [ -e {go} ]; do sleep 0.05; done; exit 4")
    assert process.stdout is not None
    left = int(process.stdout.readline())
    assert lives(left)
    go.touch()
    assert process.wait(PATIENCE_S) == 4
    assert not lives(left) and not supervisor.descendants(process.pid)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_reach_all_of_it(keep: Callable[..., subprocess.Popen[str]], number: signal.Signals) -> None:
    process = keep(sys.executable, "-c", "import subprocess\nsubprocess.run(['setsid', 'sleep', '600'])")
    wait_for("all of it", lambda: len(supervisor.descendants(process.pid)) == 2)
    tree = supervisor.descendants(process.pid)
    process.send_signal(number)
    assert process.wait(PATIENCE_S) != 0
    assert not any(map(lives, tree))


def test_parents_are_signalled_before_their_children(keep: Callable[..., subprocess.Popen[str]]) -> None:
    """A parent that sees its child end goes on, and may end with success before a signal reaches it."""
    process = keep("sh", "-c", "sh -c 'sh -c \"sleep 600; true\"; true'; true")
    wait_for("all of it", lambda: len(supervisor.descendants(process.pid)) == 4)
    tree = supervisor.descendants(process.pid)
    assert list(map(parent, tree)) == [process.pid, *tree[:-1]]


def test_who_does_not_listen_is_killed(keep: Callable[..., subprocess.Popen[str]]) -> None:
    process = keep("sh", "-c", "trap '' INT TERM; echo ready; while :; do sleep 0.1; done")
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE_S) == -signal.SIGKILL


def test_nothing_outlives_the_keeper_of_a_launcher_that_is_killed(tmp_path: Path) -> None:
    """The launcher's children are told of its death by SIGTERM; the command of one that is killed dies, too."""
    script = f"""
import os, pathlib, sys
from litsim_sim.launch.processes import Graph
graph = Graph(pathlib.Path({str(tmp_path)!r}), 7)
graph.start_stack(["sh", "-c", "setsid sleep 600 & sleep 600"])
print(graph.children["ads"].process.pid, flush=True)
sys.stdin.read()
"""
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as launcher:
        assert launcher.stdout is not None
        kept = int(launcher.stdout.readline())
        wait_for("all of it", lambda: len(supervisor.descendants(kept)) == 3)
        tree = supervisor.descendants(kept)
        launcher.kill()
    wait_for("their end", lambda: not any(map(lives, (kept, *tree))))
