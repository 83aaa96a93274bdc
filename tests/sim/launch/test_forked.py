"""Programs in copies of a process: they are what processes of their own would be."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from litsim_sim.core.errors import EXIT_INTERRUPTED
from litsim_sim.launch.child import Child
from litsim_sim.launch.processes import Graph
from patience import wait_for

TELL = """
import json, os, signal, sys
handlers = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]
print(json.dumps({
    "arguments": sys.argv[1:],
    "environment": dict(os.environ),
    "parent": os.getppid(),
    "leads": os.getsid(0) == os.getpgid(0) == os.getpid(),
    "as_at_start": handlers == [signal.default_int_handler, signal.SIG_DFL],
    "held_back": len(signal.pthread_sigmask(signal.SIG_BLOCK, [])),
    "name": open("/proc/self/cmdline").read(),
    "read": sys.stdin.read(),
    "imported": "pandas" in sys.modules,
}))
"""


def start(folder: Path, script: str, name: str = "node", **parameters: object) -> Child:
    """A node that is `script`, in a copy of this process."""
    program = folder / "program"
    program.write_text(script)
    graph = Graph(folder / "out", 7)
    graph.start(name, program, parameters, forked=True)
    return graph.children[name]


def end_of(child: Child) -> int | None:
    """Wait for it; returns what the process has left as its exit status."""
    wait_for("its end", lambda: not child.running)
    return child.process.returncode


def test_it_is_a_process_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pandas as pd  # noqa: F401 - what this process has imported, the copy has

    monkeypatch.setenv("MINE", "too")
    monkeypatch.setattr(sys, "stdout", None)  # whatever the output of this process has become
    child = start(tmp_path, TELL, text="a b", number=2)
    assert end_of(child) == 0
    told: dict[str, Any] = json.loads(child.log.read_text())
    environment = told.pop("environment")
    assert (environment["ROS_DOMAIN_ID"], environment["MINE"]) == ("7", "too")
    assert "ROS_DOMAIN_ID" not in os.environ or os.environ["ROS_DOMAIN_ID"] != "7"
    assert told.pop("name").rstrip("\0") == f"{tmp_path}/program"
    assert told == {
        "arguments": ["--ros-args", "-p", 'text:="a b"', "-p", "number:=2"],
        "parent": os.getpid(),
        "leads": True,
        "as_at_start": True,
        "held_back": 0,
        "read": "",
        "imported": True,
    }


@pytest.mark.parametrize(
    ("script", "status", "said"),
    [
        ("raise SystemExit(3)", 3, "node node ended with exit status 3"),
        ("raise OSError('lost')", 1, "node node ended with exit status 1: OSError: lost"),
        ("import os\nos.kill(os.getpid(), 9)", -signal.SIGKILL, "node node was ended by SIGKILL"),
    ],
)
def test_how_it_has_ended_is_known(tmp_path: Path, script: str, status: int, said: str) -> None:
    child = start(tmp_path, script)
    assert end_of(child) == status
    assert child.obituary() == said


def test_interrupted_while_it_imports_it_says_nothing(tmp_path: Path) -> None:
    child = start(tmp_path, "import os, signal\nos.kill(os.getpid(), signal.SIGINT)")
    assert end_of(child) == EXIT_INTERRUPTED
    assert child.log.read_text() == ""


def test_the_bridge_is_read_while_it_writes_and_its_errors_go_to_its_log(tmp_path: Path) -> None:
    script = "import sys, time\nsys.stderr.write('odd\\n')\nprint('step 1')\ntime.sleep(600)"
    child = start(tmp_path, script, "bridge")
    assert child.process.stdout is not None
    assert child.process.stdout.readline() == "step 1\n"
    child.signal(signal.SIGTERM)
    assert end_of(child) == -signal.SIGTERM
    assert child.process.stdout.read() == ""
    assert child.log.read_text() == "odd\n"


@pytest.mark.parametrize("preloaded", [False, True])
def test_it_ends_when_the_process_is_gone_that_has_asked_for_it(tmp_path: Path, preloaded: bool) -> None:
    (tmp_path / "program").write_text("import time\ntime.sleep(600)")
    script = f"""
import subprocess, sys
from litsim_sim.launch.forked import ForkedProcess
devnull = subprocess.DEVNULL
process = ForkedProcess([{str(tmp_path / "program")!r}], {{}}, stdout=devnull, stderr=devnull, preloaded={preloaded})
print(process.pid, flush=True)
sys.stdin.read()
"""
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", script], stdin=pipe, stdout=pipe, text=True) as asking:
        assert asking.stdout is not None
        started = Path(f"/proc/{int(asking.stdout.readline())}")
        assert started.exists()
        asking.kill()
    wait_for("its end", lambda: not started.exists() or " Z " in (started / "stat").read_text())


def test_what_is_preloaded_is_imported_once_and_output_comes_through_pipes(tmp_path: Path) -> None:
    (tmp_path / "program").write_text(
        "import os, sys\nprint(*sys.argv[1:], 'colorsys' in sys.modules, os.environ['MINE'], os.getcwd())\n"
        "sys.exit('oh')"
    )
    script = f"""
import os, subprocess
from litsim_sim.launch.forked import ForkedProcess, preload
preload("colorsys")
pipe = subprocess.PIPE
for name in "ab":
    process = ForkedProcess(
        [{str(tmp_path / "program")!r}, name], {{"MINE": name}}, stdout=pipe, stderr=pipe, preloaded=True
    )
    print(process.stdout.read().strip(), process.stderr.read().strip(), process.wait())
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, check=True)
    assert done.stdout == f"a True a {tmp_path} oh 1\nb True b {tmp_path} oh 1\n"
