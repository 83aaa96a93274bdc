"""Agent tables and scenarios made by hand, and a client of Foxglove's servers, for every test."""

import atexit
import json
import os
import shutil
import struct
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import litsim_sim  # noqa: F401  before numpy, whose code it chooses

# isort: split
import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import settings

from litsim_data.maps.netconvert import find_netconvert
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.installation import PIP_PACKAGE
from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, STEP_S, AgentTable, Controller, Kind
from litsim_sim.kernels.garbage import without_collection
from litsim_sim.scenario.recording import COLUMNS, Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario
from patience import PATIENCE_S, wait_for

pytest_plugins = ["made_runs", "driven_runs"]  # fixtures that tests of several packages use

# Real data, where they lie beside the project; elsewhere the tests that need them are skipped and say so.
BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"
if BESIDE.is_dir():
    os.environ.setdefault("LITSIM_DATA", str(BESIDE))
US101 = "ngsim/us101_0750_frames_0126_1149.parquet"

# Tests run in several processes at a time: more threads in each would wait for each other.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# The key by which runs are sealed is one of the tests' own.
os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="litsim-tests-")
atexit.register(shutil.rmtree, os.environ["XDG_STATE_HOME"], ignore_errors=True)

# Tests are of what LitSim ships: plug-ins that somebody has installed beside it stay out of their sight.
SHIPPED = {PIP_PACKAGE, *(path.name for path in (Path(__file__).resolve().parents[1] / "src").iterdir())}
for points in plugins._entry_points().values():
    points[:] = [each for each in points if each.dist and {each.dist.name, each.dist.name.replace("-", "_")} & SHIPPED]

# How long an example takes says nothing on a machine that is shared; on CI, hypothesis also fixes its seed.
settings.register_profile("litsim", settings(), deadline=None)
settings.load_profile("litsim")

HERE, SLOW_S = Path(__file__).parent, 1.0
SLOW = set(HERE.joinpath("slow.txt").read_text().split())
"""Folders, and files whose tests together take SLOW_S or more, as `--measure` has found."""
LEFT_OUT = {HERE / name for name in SLOW}  # of `--fast`
LANE_CENTRES = tuple(-3.66 * (lane + 0.5) for lane in range(5))
"""y of the through lanes of the packaged net us101_like, leftmost first [m]; they run along +x from 0 to 640 m."""

FOXGLOVE_MESSAGE, FOXGLOVE_TIME = 1, 2  # first byte of binary messages to a client

USUAL_AGENT: dict[str, Any] = {
    "kind": 0,
    "controller": Controller.LOG,
    "x": 0.0,
    "y": 0.0,
    "yaw": 0.0,
    "speed": 10.0,
    "acceleration": 0.0,
    "yaw_rate": 0.0,
    "length": 4.5,
    "width": 2.0,
}


def agent_table(step: int, *agents: dict[str, Any]) -> AgentTable:
    """Agents at a step; of each at least its id, the rest as in USUAL_AGENT."""
    rows = sorted(({**USUAL_AGENT, **agent} for agent in agents), key=lambda row: row["id"])
    return AgentTable(step, *(np.array([row[f] for row in rows], DTYPES[f]) for f in ARRAY_FIELDS))


@dataclass(frozen=True)
class Track:
    """A vehicle that drives straight on with constant acceleration while it is recorded.

    Attributes:
        first, last: first and last step, both included.
        x, y: box centre at the first step [m].
    """

    id: int
    x: float
    y: float = LANE_CENTRES[1]
    speed: float = 10.0
    acceleration: float = 0.0
    yaw: float = 0.0
    first: int = 0
    last: int = 60
    length: float = 4.5
    width: float = 2.0
    kind: Kind = Kind.CAR

    def rows(self) -> pd.DataFrame:
        """The recording's rows of this vehicle."""
        step = np.arange(self.first, self.last + 1)
        t = STEP_S * (step - self.first)
        speed = self.speed + self.acceleration * t
        assert (speed >= 0).all()
        gone = self.speed * t + 0.5 * self.acceleration * t**2
        values = {
            "vehicle_id": self.id,
            "frame": step,
            "x": self.x + gone * np.cos(self.yaw),
            "y": self.y + gone * np.sin(self.yaw),
            "yaw": self.yaw,
            "speed": speed,
            "acceleration": self.acceleration,
            "length": self.length,
            "width": self.width,
            "kind": int(self.kind),
            "lane": -1,
        }
        return pd.DataFrame(values)[list(COLUMNS)]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds the option of `make test-fast`, and the one that says what is fast."""
    parser.addoption("--fast", action="store_true", help="without the files and folders of tests/slow.txt")
    parser.addoption("--measure", action="store_true", help="note in tests/slow.txt which of the files run are slow")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leaves out slow tests where only fast ones are asked for."""
    return True if config.getoption("--fast") and collection_path in LEFT_OUT else None


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Notes which files are slow, where that is asked for; of those that were not run, it stays as it was."""
    seconds: Counter[str] = Counter()
    for report in (each for reports in terminalreporter.stats.values() for each in reports):
        if isinstance(report, pytest.TestReport):
            seconds[report.nodeid.partition("::")[0].removeprefix("tests/")] += report.duration
    if terminalreporter.config.getoption("--measure"):
        of_folders = {file for file in seconds if SLOW.intersection(map(str, Path(file).parents))}
        slow = SLOW - seconds.keys() | {file for file, took in seconds.items() if took >= SLOW_S} - of_folders
        HERE.joinpath("slow.txt").write_text("\n".join([*sorted(slow, key=lambda file: ("/" in file, file)), ""]))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Reads the tests without a search for garbage: what is read stays."""
    with without_collection():
        return (yield)


@pytest.hookimpl(trylast=True)  # once those of the graph are marked
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spread the files with tests of the graph, which mostly wait, evenly among the others, which mostly compute."""
    files = [list(tests) for _, tests in groupby(items, key=lambda item: item.path)]
    waiting = [tests for tests in files if any(test.get_closest_marker("graph") for test in tests)]
    computing = [tests for tests in files if not any(test.get_closest_marker("graph") for test in tests)]
    places = [((k + 0.5) / len(kind), tests) for kind in (waiting, computing) for k, tests in enumerate(kind)]
    items[:] = [test for _, tests in sorted(places, key=lambda place: place[0]) for test in tests]


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Clean up, once for all processes, the shared memory that nodes leave behind when they are killed."""
    if not hasattr(session.config, "workerinput") and (fastdds := shutil.which("fastdds")):
        subprocess.run([fastdds, "shm", "clean"], capture_output=True, check=False)


@pytest.fixture(scope="session")
def real_data() -> Callable[..., Path]:
    """Finds a file of real recordings below LITSIM_DATA, US-101 unless named; without it, the test is skipped."""

    def find(name: str = US101) -> Path:
        path = Path(os.environ.get("LITSIM_DATA") or BESIDE) / name
        if not path.is_file():
            pytest.skip(f"{path} is not there: LITSIM_DATA names no folder with that file")
        return path

    return find


@pytest.fixture(scope="session")
def netconvert() -> None:
    """SUMO's netconvert; without it, the test is skipped."""
    try:
        find_netconvert()
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session", name="agent_table")
def agent_table_fixture() -> Callable[..., AgentTable]:
    return agent_table


@pytest.fixture(scope="session")
def lane_centres() -> tuple[float, ...]:
    return LANE_CENTRES


@pytest.fixture(scope="session")
def track() -> type[Track]:
    """For `make_scenario`."""
    return Track


@pytest.fixture(scope="session")
def make_scenario(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Scenario]:
    """Builds scenarios on the packaged net us101_like from tracks; the ego is the first one."""

    def make(*tracks: Track, history_steps: int = 3, **fields: Any) -> Scenario:
        folder: Path = tmp_path_factory.mktemp("scenario")
        table = pd.concat([track.rows() for track in tracks], ignore_index=True)
        Recording.from_table(RecordingHeader("made"), table, "made").write(folder / "made.parquet")
        usual = {"name": "made", "recording": "made.parquet", "net": "us101_like", "ego": tracks[0].id}
        file = usual | {"history_s": history_steps * STEP_S} | fields
        (folder / "made.yaml").write_text(yaml.safe_dump(file))
        return Scenario.load(folder / "made.yaml")

    return make


class FoxgloveClient:
    """Speaks Foxglove's WebSocket protocol (foxglove.sdk.v1), as far as tests need it.

    Attributes:
        channels: what the server has advertised, by topic.
    """

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self._arrived: list[tuple[str, int, bytes]] = []
        self._topics: dict[int, str] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.wait(lambda: self.channels)

    def subscribe(self, *topics: str) -> None:
        """Ask for topics; subscription ids are those of the channels."""
        ids = [self.channels[topic]["id"] for topic in topics]
        self._topics |= dict(zip(ids, topics, strict=True))
        asked = [{"id": each, "channelId": each} for each in ids]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": asked}))

    def receive(self) -> tuple[str, int, bytes]:
        """The next message: topic (or `time`), its time [ns], its data."""
        self.wait(self.arrived)
        return self._arrived.pop(0)

    def arrived(self) -> bool:
        """Whether there is a next message."""
        return bool(self._arrived)

    def wait(self, done: Callable[[], object]) -> None:
        """Listen until `done`."""
        wait_for("the server", done, self._listen)

    def _listen(self) -> None:
        try:
            data = self._socket.recv(timeout=0.05)
        except TimeoutError:
            return
        if isinstance(data, str):
            said = json.loads(data)
            self.channels |= {each["topic"]: each for each in said.get("channels", ())}
        elif data[0] == FOXGLOVE_MESSAGE:
            subscription, time_ns = struct.unpack_from("<IQ", data, 1)
            self._arrived.append((self._topics[subscription], time_ns, data[13:]))
        elif data[0] == FOXGLOVE_TIME:
            self._arrived.append(("time", struct.unpack_from("<Q", data, 1)[0], b""))


@pytest.fixture
def foxglove_client() -> Iterator[Callable[[str], FoxgloveClient]]:
    """Makes clients, and lets them go."""
    client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
    how = {"subprotocols": ["foxglove.sdk.v1"], "max_size": None, "open_timeout": PATIENCE_S}
    with ExitStack() as stack:
        yield lambda url: FoxgloveClient(stack.enter_context(client.connect(url, **how)))
