"""Graphs over real DDS: each in a domain of its own, on this machine, and ended whatever a test does."""

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import domain_coordinator
import numpy as np
import pandas as pd
import pytest
import yaml
from ament_index_python.packages import get_package_prefix
from filelock import FileLock

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.launch.signals import end_with_parent
from litsim_sim.record.bag import BagReader
from litsim_sim.scenario.recording import Recording, RecordingHeader
from patience import PATIENCE_S, wait_for

HERE = Path(__file__).parent
MARK = "LITSIM_TEST"  # variable by which a graph's processes are known
ANSWER_S = 60.0  # that runs wait for answers, unless a test says otherwise: however busy the machine is
SHORT: dict[str, Any] = {
    "name": "short",
    "recording": "traffic.parquet",
    "net": "us101_like",
    "history_s": 0.5,
    "simulation_s": 3.0,
    "ego": 13,  # it brakes, and its tailgater is taken over
}


def traffic(seconds: float) -> Recording:
    """Forty cars in five lanes at 15 m/s for 10 s, or for so many more; the one behind car 13 is close."""
    frames, speed = np.arange(max(100, round(seconds / STEP_S))), 15.0
    same = {"yaw": 0.0, "speed": speed, "acceleration": 0.0, "length": 4.5, "width": 2.0, "kind": 0, "lane": -1}
    cars = [
        {"vehicle_id": 8 * lane + place + 1, "x": 10.0 + 25.0 * place + 2.0 * lane, "y": -3.66 * (lane + 0.5)}
        for lane in range(5)
        for place in range(8)
    ]
    table = pd.concat([pd.DataFrame({"frame": frames, **car, **same}) for car in cars], ignore_index=True)
    table["x"] += speed * STEP_S * table["frame"]
    table.loc[table["vehicle_id"] == 12, "x"] += 15.0
    return Recording.from_table(RecordingHeader("traffic"), table, "traffic")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.graph)


@dataclass
class Graph:
    """Processes that belong to one test.

    Attributes:
        folder: for logs and outputs.
        domain: ROS_DOMAIN_ID that is reserved for nodes started one by one; the launcher finds one itself.
    """

    folder: Path
    domain: int
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def scenario(self, **fields: Any) -> Path:
        """A scenario file; SHORT but for `fields`, of which None leaves one out."""
        traffic(1.0 + fields.get("simulation_s", 0.0)).write(self.folder / "traffic.parquet")
        path = self.folder / "short.yaml"
        path.write_text(yaml.safe_dump({k: v for k, v in (SHORT | fields).items() if v is not None}, sort_keys=False))
        return path

    def launch(self, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run the launcher to its end."""
        return self.finish(self.start_launch(*arguments, **environment))

    def start_launch(
        self, *arguments: object, through: tuple[object, ...] = (), **environment: str
    ) -> subprocess.Popen[str]:
        """Start the launcher, maybe `through` a command that starts it."""
        patience = () if "--answer-timeout" in arguments else ("--answer-timeout", ANSWER_S)
        return self._start([*through, program("litsim_sim", "launch"), *patience, *arguments], environment)

    def start_program(
        self, package: str, executable: str, *arguments: object, **environment: str
    ) -> subprocess.Popen[str]:
        """Start a program of ours that is no node."""
        return self._start([program(package, executable), *arguments], environment)

    def start_node(self, package: str, executable: str, *arguments: str, **parameters: object) -> subprocess.Popen[str]:
        """Start one node in :attr:`domain`, as ``ros2 run`` does."""
        if executable == "bridge" and parameters:
            parameters = {"answer_timeout_s": ANSWER_S} | parameters
        given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        ros = ["--ros-args", *arguments, *given] if given or "-p" in arguments else arguments
        return self._start([program(package, executable), *ros], {"ROS_DOMAIN_ID": str(self.domain)})

    def start_script(self, name: str, *arguments: object) -> subprocess.Popen[str]:
        """Start a script of this folder in :attr:`domain`."""
        return self._start([sys.executable, HERE / "programs" / name, *arguments], {"ROS_DOMAIN_ID": str(self.domain)})

    def finish(self, process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
        """Wait for a process to end by itself."""
        out, err = process.communicate(timeout=2 * PATIENCE_S)
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def end(self, process: subprocess.Popen[str], number: signal.Signals = signal.SIGINT) -> tuple[int, str]:
        """Signal a process that runs; returns its exit status and what it said."""
        assert process.poll() is None, process.communicate()
        process.send_signal(number)
        done = self.finish(process)
        return done.returncode, done.stdout + done.stderr

    def running(self) -> dict[int, str]:
        """Command line by id of every process of this graph, children of children included.

        One that has been given a name may show it where its environment was; it is known by the folder that it is in.
        """
        wanted, here, found = f"{MARK}={self.mark}".encode(), self.folder.resolve(), {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if wanted in (folder / "environ").read_bytes().split(b"\0") or (folder / "cwd").readlink() == here:
                    found[int(folder.name)] = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:  # it ended, or is somebody else's
                continue
        return {pid: line for pid, line in found.items() if line}  # without zombies

    def signal(self, executable: str, number: signal.Signals) -> None:
        """Signal the one node of that executable."""
        (pid,) = (pid for pid, line in self.running().items() if f"/{executable} " in line)
        os.kill(pid, number)

    def wait_under_way(self, bag: Path) -> None:
        """Wait until the run that is recorded to `bag` is well past its beginning."""
        wait_for(f"step 9 in {bag}", lambda: recorded_step(bag) >= 9)

    def close(self) -> None:
        """End everything, by process id."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            for pid in self.running():
                try:
                    os.kill(pid, number)
                except ProcessLookupError:
                    continue
            until = time.monotonic() + 5.0
            while self.running() and time.monotonic() < until:
                time.sleep(0.05)
        for process in self.started:
            process.communicate()

    def _start(self, command: list[object], environment: dict[str, str]) -> subprocess.Popen[str]:
        usual = {k: v for k, v in os.environ.items() if k not in ("ROS_DOMAIN_ID", "COLUMNS")}
        usual |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", MARK: self.mark, "PYTHONUNBUFFERED": "1"}
        process = subprocess.Popen(
            [str(word) for word in command],
            env=usual | environment,
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=end_with_parent,  # noqa: PLW1509 - one system call; tests that are killed leave nobody behind
        )
        self.started.append(process)
        return process


def program(package: str, executable: str) -> Path:
    """What ``ros2 run`` starts."""
    return Path(get_package_prefix(package)) / "lib" / package / executable


def recorded_step(bag: Path) -> int:
    """Last step in the chunks that have reached the file so far; -1 before the first."""
    try:
        return max((m.log_time_ns // 10**8 for m in BagReader(bag).messages({"/litsim/agents"})), default=-1)
    except InputError:  # not there yet
        return -1


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    with domain_coordinator.domain_id() as domain:
        made = Graph(tmp_path, domain)
        yield made
        made.close()


@dataclass(frozen=True)
class Recorded:
    """A finished run."""

    bag: Path
    scenario: Path
    done: subprocess.CompletedProcess[str]


def _record(folder: Path, ego: str, policy: str) -> None:
    """Launch a run of SHORT, and note how the launcher ended."""
    made = Graph(folder, -1)
    try:
        words = ("--scenario", made.scenario(), "--ego", ego, "--policy", policy, "--out", folder / "run")
        many = ("--set", "bridge.external_timeout_s=100.0")  # an option of many values before the command
        stack = (*many, "--", sys.executable, HERE / "programs/external_ego.py") if ego == "external" else ()
        done = made.launch(*words, *stack)
        assert not made.running()
    finally:
        made.close()
    (folder / "done.json").write_text(json.dumps([done.returncode, done.stdout, done.stderr]))


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Recorded]:
    """Launches a run of SHORT, an external ego being external_ego.py.

    The same one is launched only once, whichever of pytest's processes asks for it first.
    """
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent  # of all processes of this session

    def run(ego: str, policy: str, time_: str = "first") -> Recorded:
        folder = shared / f"recorded_{ego}_{policy}_{time_}"
        with FileLock(f"{folder}.lock"):
            if not (folder / "done.json").is_file():
                folder.mkdir()
                _record(folder, ego, policy)
        ended, out, err = json.loads((folder / "done.json").read_text())
        return Recorded(folder / "run", folder / "short.yaml", subprocess.CompletedProcess([], ended, out, err))

    return run
