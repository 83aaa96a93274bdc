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

from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, STEP_NS, AgentTable, Controller
from litsim_sim.core.stages import StageState
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.record.bag import BagWriter
from litsim_sim.record.run import Run, RunInfo, Status
from litsim_sim.scenario.recording import COLUMNS

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


Skip = Collection[tuple[str, int]]


def write_run(run: Run, folder: Path, skip: Skip = (), twice: Skip = (), finish: bool = True) -> Path:
    """Write `run` as the recorder does; `skip` and `twice` name topics and steps that are left out or doubled."""
    from rclpy.serialization import serialize_message  # ROS takes a moment to load, and few tests write a run

    from litsim_sim.ros.cdr import without_padding
    from litsim_sim.ros.topics import RECORDED_TOPICS

    writer = BagWriter(folder, "run")
    messages = list(_messages(run))
    written = {topic for topic, _, _ in messages}
    for topic in RECORDED_TOPICS:
        if topic in written:
            writer.add_topic(topic.described)
    texts = {"scenario.yaml": run.info.scenario_yaml.encode(), "net.xml": run.net_xml}
    for name, data in (texts | {"recording.parquet": recording_bytes(run)}).items():
        if data:
            writer.attach(name, "", data)
    for topic, step, message in messages:
        for _ in range(int((topic.name, step) not in skip) + int((topic.name, step) in twice)):
            writer.write(topic.name, without_padding(topic.type)(serialize_message(message)), step * STEP_NS)
    if finish:
        writer.close()
    else:
        writer.abort()
    return folder


def _messages(run: Run) -> Iterator[tuple[Any, int, Any]]:
    """Topic, step and message of all that a recorder hears."""
    from rosgraph_msgs.msg import Clock

    from litsim_policy.conflict.messages import takeovers_to_message
    from litsim_sim.ros import messages, topics

    run_id = run.info.run_id
    fields = {k: list(v) if isinstance(v, tuple) else v for k, v in vars(run.info).items()}
    yield topics.RUN_INFO, 0, topics.RUN_INFO.type(header=messages.header(0), **fields)
    for each in run.tables:
        step = each.step
        yield topics.CLOCK, step, Clock(clock=messages.stamp(step))
        yield topics.AGENTS, step, messages.agents_to_message(each, run_id, run.info.total_steps, run.info.ego_id)
        if step in run.takeovers:
            takeovers = TakeoverTable(step, tuple(run.takeovers[step]), iterations=1, converged=True)
            yield topics.TAKEOVERS, step, takeovers_to_message(takeovers, run_id)
        if step in run.controls:
            yield topics.CONTROLS, step, messages.controls_to_message(run.controls[step], run_id)
        if step in run.ego_commands:
            yield topics.EGO_CONTROL, step, messages.ego_to_message(run.ego_commands[step], run_id)
        for stage, seconds in run.timing.items():
            timing = messages.status(run_id, stage, StageState.RUNNING, step, seconds[step])
            yield topics.TIMING, step, timing
    for said in run.statuses:
        status = messages.status(run_id, said.stage, said.state, said.step, said.compute_time, said.text)
        yield topics.STATUS, said.step, status


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
