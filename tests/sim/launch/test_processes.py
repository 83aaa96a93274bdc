"""What the processes of a graph are started with."""

import io
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from litsim_sim.core.stages import BRIDGE, RECORDER
from litsim_sim.launch.domain import DOMAIN_PORTS, EMPTY, FIRST_PORT, graph_domain
from litsim_sim.launch.middleware import ENCLAVE, PROFILES, RANGE, SECURITY
from litsim_sim.launch.processes import STACK, Graph, GraphFailed, Progress
from litsim_sim.record.seal import RunFacts


def environment(folder: Path) -> dict[str, str]:
    """What a node that is started by the launcher finds in its environment."""
    folder.mkdir()
    graph = Graph(folder / "out", 7)
    graph.start("node", says_variables(folder), {})
    try:
        graph.children["node"].process.wait(60.0)
    finally:
        graph.stop()
    return variables(graph.children["node"].log.read_text())


def says_variables(folder: Path) -> Path:
    """A program in `folder` that does what ``env`` does."""
    program = folder / "node"
    program.write_text("#!/bin/sh\nenv\n")
    program.chmod(0o755)
    return program


def variables(text: str) -> dict[str, str]:
    """What ``env`` has said."""
    return dict(line.split("=", 1) for line in text.splitlines() if "=" in line)


def test_nodes_stay_on_this_machine_unless_the_user_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(RANGE, raising=False)
    found = environment(tmp_path / "usual")
    assert (found["ROS_DOMAIN_ID"], found[RANGE]) == ("7", "LOCALHOST")
    monkeypatch.setenv(RANGE, "SUBNET")
    assert environment(tmp_path / "chosen")[RANGE] == "SUBNET"


def test_the_bridge_alone_is_told_that_nobody_was_in_the_domain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(RANGE, raising=False)
    monkeypatch.delenv(PROFILES[0], raising=False)
    monkeypatch.delenv(EMPTY, raising=False)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    program = says_variables(tmp_path)
    with graph_domain(None, reserve=True) as domain:  # others may still end in one that is free
        assert told(Graph(tmp_path / "alone", domain), program) == {BRIDGE: str(domain), "other": None}
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
            somebody.bind(("127.0.0.1", FIRST_PORT + DOMAIN_PORTS * domain + 10))
            graph = Graph(tmp_path / "beside", domain)
        assert told(graph, program) == {BRIDGE: None, "other": None}


def told(graph: Graph, program: Path) -> dict[str, str | None]:
    """What the bridge and another process of `graph` find in :data:`EMPTY`; `program` says it."""
    try:
        for name in (BRIDGE, "other"):
            graph.start(name, program, {})
        bridge = graph.children[BRIDGE].process.stdout
        assert bridge is not None
        lines = {BRIDGE: bridge.read()}
        graph.children["other"].process.wait(60.0)
        lines["other"] = graph.children["other"].log.read_text()
    finally:
        graph.stop()
    return {name: variables(text).get(EMPTY) for name, text in lines.items()}


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
        found[secured] = variables(graph.children[STACK].log.read_text())
    assert ENCLAVE not in found["false"]
    assert found["true"][ENCLAVE] == "/litsim/ads"


WAIT = "until [ -e {0} ]; do sleep 0.01; done"


def failure(folder: Path, bridge: str, stack: str = "sleep 600", recorder: str = "sleep 600") -> str:
    """Why a run fails whose steps wait for half a second, by the scripts of its bridge, stack and recorder."""
    graph = Graph(folder / "out", 7, answer_timeout_s=0.5)
    try:
        graph.start_stack(["sh", "-c", stack])
        for name, script in ((BRIDGE, bridge), (RECORDER, recorder)):
            program = folder / name
            program.write_text(f"#!/bin/sh\n{script}\n")
            program.chmod(0o755)
            graph.start(name, program, {})
        with pytest.raises(GraphFailed) as found:
            graph.watch(quiet=True)
    finally:
        graph.stop()
    return str(found.value)


@pytest.mark.parametrize(
    ("stack", "how"),
    [
        ("echo bye; touch {}; exit 0", ") was running, and said last: bye"),
        ("echo over: no answer; touch {}; exit 0", ") was running"),
        ("echo bye; touch {}; exit 6", ") ended with exit status 6: bye"),
    ],
)
def test_a_stack_that_ends_on_hearing_that_the_run_has_failed_did_not_quit(
    tmp_path: Path, stack: str, how: str
) -> None:
    heard, gone = tmp_path / "heard", tmp_path / "gone"
    say = f"{sys.executable} -c \"import time; print('failed at', time.monotonic(), 's')\""
    failing = f"{say}; touch {heard}; {WAIT.format(gone)}; sleep 1.5; echo 'error: no answer' >&2; exit 1"
    said = failure(tmp_path, failing, f"{WAIT.format(heard)}; {stack.format(gone)}")
    assert said.startswith("no answer; the stack (sh -c ")
    assert said.endswith(how)


@pytest.mark.parametrize("status", [0, 6])
def test_a_stack_that_quits_is_told_before_the_bridge_misses_its_answers(tmp_path: Path, status: int) -> None:
    said = failure(tmp_path, "sleep 15; echo 'error: no answer' >&2; exit 1", f"echo bye; exit {status}")
    assert said == f"the stack (sh -c 'echo bye; exit {status}') ended with exit status {status}: bye"


def test_who_is_stopped_for_good_is_named(tmp_path: Path) -> None:
    said = failure(tmp_path, "echo alive at step 7; kill -STOP $$", stack="sleep 20")
    assert said == "node bridge: no sign of life for 1 s, at step 7; it is stopped, by a signal or a debugger"
    pid = tmp_path / "pid"
    until_stopped = f"until grep -q 'State:.T' /proc/$(cat {pid})/status; do sleep 0.01; done"
    failing = f"{until_stopped}; echo 'error: recorder: has confirmed only step 3' >&2; exit 1"
    said = failure(tmp_path, failing, recorder=f"echo $$ > {pid}; kill -STOP $$")
    assert said.startswith("recorder: has confirmed only step 3; stopped, by a signal or a debugger: node recorder;")


@pytest.mark.parametrize(("quiet", "said"), [(False, "waiting for Godot\nwaiting for one\n"), (True, "")])
def test_what_the_bridge_waits_for_is_said_once(capsys: pytest.CaptureFixture[str], quiet: bool, said: str) -> None:
    lines = ("note waiting for Godot", "alive at step 0", "note waiting for Godot", "note waiting for one")
    Progress(io.StringIO("".join(f"{line}\n" for line in lines)), quiet).run()
    assert capsys.readouterr().err == said


@pytest.mark.parametrize("told", [[], ["230", "99"]])
def test_a_run_has_one_end_whoever_writes_to_the_output_of_the_bridge(tmp_path: Path, told: list[str]) -> None:
    ends = [RunFacts("run-1", int(step), "00ff", 1.0, "") for step in told]
    graph = Graph(tmp_path, 7)
    graph._progress = Progress(io.StringIO("".join(f"facts {each.text}\n" for each in ends)), quiet=True)
    graph._progress.run()
    with pytest.raises(GraphFailed, match=f"^node bridge has told {len(told)} ends of the run"):
        graph.facts()


DEFERRED = """
import os, signal, threading, time
from litsim_sim.launch.signals import signals_deferred

signal.signal(signal.SIGINT, signal.default_int_handler)
threading.Thread(target=time.sleep, args=(600,), daemon=True).start()  # takes what this thread does not
try:
    with signals_deferred():
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
    done = subprocess.run([sys.executable, "-c", DEFERRED], capture_output=True, text=True, timeout=100, check=False)
    assert done.stdout.splitlines() == ["started", "interrupted"]
    assert done.stderr.splitlines()[-1] == "KeyboardInterrupt"
