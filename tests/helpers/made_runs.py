"""Runs made by hand, as arrays and as bags."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from litsim_sim.core.scene import ARRAY_FIELDS, CONTROL_DTYPES, DTYPES, AgentTable, Controller
from litsim_sim.core.stages import StageState
from litsim_sim.record.bag import BagTopic, BagWriter, qos_yaml
from litsim_sim.record.run import Run, RunInfo, Status
from litsim_sim.scenario.recording import COLUMNS

MESSAGES = Path(__file__).resolve().parents[2] / "src/litsim_msgs/msg"
START_FRAME = 100
EGO = 1


def table(step: int, *agents: dict[str, Any]) -> AgentTable:
    """Agents at a step; of each at least id, x and y, the rest as below."""
    usual = {"kind": 0, "controller": Controller.LOG, "yaw": 0.0, "speed": 10.0, "acceleration": 0.0, "yaw_rate": 0.0}
    usual |= {"length": 4.0, "width": 2.0}
    rows = sorted(({**usual, **agent} for agent in agents), key=lambda row: row["id"])
    return AgentTable(step, *(np.array([row[f] for row in rows], DTYPES[f]) for f in ARRAY_FIELDS))


def info(**values: Any) -> RunInfo:
    usual: dict[str, Any] = {
        "run_id": "run-1",
        "scenario": "demo",
        "scenario_yaml": f"name: demo\nstart_frame: {START_FRAME}\n",
        "ego": "idm",
        "policy": "litsim",
        "ego_id": EGO,
        "seed": 3,
        "total_steps": 0,
        "history_steps": 0,
        "dt": 0.1,
        "mode": "lockstep",
        "stages": ("policy", "recorder"),
        "topics": ("/clock", "/litsim/agents", "/litsim/controls", "/litsim/ego/control"),
        "configuration": "",
        "versions": "",
    }
    return RunInfo(**(usual | values))


def make_run(tables: list[AgentTable], log: list[AgentTable] | None = None, **values: Any) -> Run:
    """A complete run of `tables`, whose log is `log`; fields of RunInfo and of Run by name."""
    last = tables[-1].step
    of_info = {k: values.pop(k) for k in list(values) if k in RunInfo.__dataclass_fields__}
    summary = {"missed": {}, "late_entries": [], "ended": {"reason": "time", "step": last, "lane": ""}}
    said = Status(last, "bridge", StageState.FINISHED, 2.0, yaml.safe_dump(summary))
    usual = {"statuses": [said], "log": tables if log is None else log}
    return Run(Path("run_0.mcap"), info(**({"total_steps": last} | of_info)), tables, **(usual | values))


class RosTypes:
    """Serialises messages by the definitions in the source tree, without ROS."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        for path in MESSAGES.glob("*.msg"):
            self.store.register(get_types_from_msg(path.read_text(), f"litsim_msgs/msg/{path.stem}"))

    def header(self, step: int) -> Any:
        nanoseconds = step * 100_000_000
        stamp = self.make("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="map")

    def make(self, kind: str, /, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def cdr(self, kind: str, /, **values: Any) -> bytes:
        return bytes(self.store.serialize_cdr(self.make(kind, **values), kind))

    def definition(self, kind: str) -> str:
        return self.store.generate_msgdef(kind, ros_version=2)[0]


TOPICS = {
    "/litsim/run_info": "litsim_msgs/msg/RunInfo",
    "/litsim/status": "litsim_msgs/msg/StageStatus",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/litsim/agents": "litsim_msgs/msg/AgentStates",
    "/litsim/takeovers": "litsim_msgs/msg/Takeovers",
    "/litsim/controls": "litsim_msgs/msg/Controls",
    "/litsim/ego/control": "litsim_msgs/msg/EgoControl",
    "/litsim/timing": "litsim_msgs/msg/StageStatus",
}

Skip = Collection[tuple[str, int]]


def write_run(run: Run, folder: Path, skip: Skip = (), twice: Skip = (), finish: bool = True) -> Path:
    """Write `run` as the recorder does; `skip` and `twice` name topics and steps that are left out or doubled."""
    types = RosTypes()
    writer = BagWriter(folder, "run")
    writer.add_metadata("run", {"run_id": run.info.run_id})
    for topic, kind in TOPICS.items():
        writer.add_topic(BagTopic(topic, kind, types.definition(kind), qos_yaml(10), types.store.hash_rihs01(kind)))
    texts = {"scenario.yaml": run.info.scenario_yaml.encode(), "net.xml": run.net_xml}
    for name, data in (texts | {"recording.parquet": recording_bytes(run)}).items():
        if data:
            writer.attach(name, "", data)
    for topic, step, values in _messages(run, types):
        head = {} if topic == "/clock" else {"header": types.header(step)}
        for _ in range(int((topic, step) not in skip) + int((topic, step) in twice)):
            writer.write(topic, types.cdr(TOPICS[topic], **head, **values), step * 100_000_000)
    if finish:
        writer.close()
    else:
        writer.abort()
    return folder


def _messages(run: Run, types: RosTypes) -> Iterator[tuple[str, int, dict[str, Any]]]:
    """Topic, step and fields (without headers) of every message."""
    run_id = {"run_id": run.info.run_id}
    yield "/litsim/run_info", 0, {k: list(v) if isinstance(v, tuple) else v for k, v in vars(run.info).items()}
    for each in run.tables:
        step = each.step
        both = run_id | {"step": step}
        yield "/clock", step, {"clock": types.header(step).stamp}
        total = {"total_steps": run.info.total_steps, "ego_id": run.info.ego_id}
        yield "/litsim/agents", step, both | total | {f: getattr(each, f) for f in ARRAY_FIELDS}
        if step in run.takeovers:
            records = [_takeover(types, record) for record in run.takeovers[step]]
            yield "/litsim/takeovers", step, both | {"iterations": 1, "converged": True, "takeovers": records}
        if step in run.controls:
            yield "/litsim/controls", step, both | {f: getattr(run.controls[step], f) for f in CONTROL_DTYPES}
        if step in run.ego_commands:
            yield "/litsim/ego/control", step, run_id | vars(run.ego_commands[step])
        for stage, seconds in run.timing.items():
            yield "/litsim/timing", step, run_id | vars(Status(step, stage, StageState.RUNNING, seconds[step], ""))
    for status in run.statuses:
        yield "/litsim/status", status.step, run_id | vars(status)


def _takeover(types: RosTypes, record: Any) -> Any:
    values = dict(vars(record))
    for name in ("conflict_pose", "goal_pose"):
        x, y, theta = values[name]
        values[name] = types.make("geometry_msgs/msg/Pose2D", x=x, y=y, theta=theta)
    values["reference_path"] = record.reference_path.ravel()
    return types.make("litsim_msgs/msg/Takeover", **values)


def recording_bytes(run: Run) -> bytes:
    """The log of `run` as a Parquet file in the neutral schema."""
    if not run.log:
        return b""
    frames = []
    for each in run.log:
        columns = {c: getattr(each, c) for c in COLUMNS if c not in ("vehicle_id", "frame", "lane")}
        frames.append(pd.DataFrame({**columns, "vehicle_id": each.id, "frame": START_FRAME + each.step, "lane": -1}))
    arrow = pa.Table.from_pandas(pd.concat(frames)[list(COLUMNS)].astype(COLUMNS), preserve_index=False)
    buffer = BytesIO()
    pq.write_table(arrow.replace_schema_metadata({b"litsim": b'{"name": "made"}'}), buffer)
    return buffer.getvalue()


def moved(log: list[AgentTable], agent: int, **offsets: float) -> list[AgentTable]:
    """`log` with constants added to columns of one agent."""
    out = []
    for each in log:
        given = {name: getattr(each, name) for name in offsets}
        columns = {n: np.where(each.id == agent, v + offsets[n], v).astype(v.dtype) for n, v in given.items()}
        out.append(replace(each, **columns))
    return out


@pytest.fixture(name="table")
def table_fixture() -> Callable[..., AgentTable]:
    return table


@pytest.fixture(name="make_run")
def make_run_fixture() -> Callable[..., Run]:
    return make_run


@pytest.fixture(name="write_run")
def write_run_fixture() -> Callable[..., Path]:
    return write_run


@pytest.fixture(name="moved")
def moved_fixture() -> Callable[..., list[AgentTable]]:
    return moved


@pytest.fixture
def ego_id() -> int:
    return EGO
