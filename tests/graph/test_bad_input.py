"""What cannot work is refused in one line that says where and what was expected; nobody waits for ever."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from litsim_sim.scenario.recording import HEADER_KEY, Recording

HANDSHAKE_S = 30.0  # the others start within it, however busy the machine is


def damaged(graph: Any, damage: str) -> Path:
    """The recording of the usual scenario, not as it should be."""
    graph.scenario()
    recording = Recording.read(graph.folder / "traffic.parquet")
    table = recording.table.copy()
    if damage == "hole":
        table = table[~((table["vehicle_id"] == 13) & (table["frame"] == 90))]
    elif damage == "nan":
        table.loc[1234, "speed"] = np.nan
    elif damage == "column":
        table = table.rename(columns={"yaw": "heading"})
    elif damage == "elsewhere":
        table["x"] += 5000.0
    arrow = pa.Table.from_pandas(table, preserve_index=False)
    header = json.dumps({"name": "damaged"}).encode()
    path = graph.folder / f"{damage}.parquet"
    pq.write_table(arrow.replace_schema_metadata({HEADER_KEY: header}), path)
    return path


def refused(graph: Any, *arguments: object) -> str:
    """What the launcher says: one line, with nothing started and nothing left behind."""
    done = graph.launch("--out", graph.folder / "run", *arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert not (graph.folder / "run").exists()
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    return line


def test_scenario_that_is_missing_or_malformed(graph: Any) -> None:
    missing = graph.folder / "none.yaml"
    assert f"{missing}: no such scenario; expected a YAML file, or one of demo" in refused(graph, "--scenario", missing)
    (graph.folder / "bad.yaml").write_text("name: bad\nego: [1\n")
    line = refused(graph, "--scenario", graph.folder / "bad.yaml")
    assert "bad.yaml: malformed YAML" in line
    assert "line 3" in line


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"egoo": 13}, "short.yaml: line 7, field egoo: Extra inputs are not permitted; known fields: name, "),
        ({"ego": 4711}, "short.yaml: field ego: no vehicle 4711; present at the start: "),
        ({"recording": "none.parquet"}, "short.yaml: field recording: "),
        ({"net": None}, "short.yaml: field net: Field required"),
    ],
)
def test_scenario_field(graph: Any, fields: dict[str, Any], expected: str) -> None:
    assert expected in refused(graph, "--scenario", graph.scenario(**fields))


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        ("hole", "hole.parquet: vehicle_id 13: frame 89 is followed by a hole (next row: frame 91); expected one row"),
        ("nan", "nan.parquet: row 1235 (vehicle_id "),
        ("column", "column.parquet: unknown columns ['heading'], missing columns ['yaw']; expected exactly "),
        ("elsewhere", "short.yaml: net us101_like.net.xml does not cover the recording: 0.0% of the box centres"),
    ],
)
def test_recording(graph: Any, damage: str, expected: str) -> None:
    assert expected in refused(graph, "--scenario", graph.scenario(recording=str(damaged(graph, damage))))


def test_choices_of_the_command_line(graph: Any) -> None:
    scenario = graph.scenario()
    assert "field ego: no vehicle 4711" in refused(graph, "--scenario", scenario, "--ego-id", 4711)
    line = refused(graph, "--scenario", scenario, "--domain-id", 233)
    assert line == "error: ROS_DOMAIN_ID is '233', expected 0 to 232"
    for arguments, expected in (
        (("--policy", "nice"), "argument --policy: invalid choice: 'nice' (choose from "),
        (("--answer-timeout", "0"), "argument --answer-timeout: '0', expected a number of more than 0"),
        (("--vehicle", "delay_s=0.25"), "argument --vehicle: delay_s=0.25: delay_s is 0.25, expected a multiple of "),
        (("--ego-interface", "twist"), "error: --ego-interface twist: the ego is idm, expected --ego external"),
        (("--vehicle", "wheels=4"), "argument --vehicle: wheels=4: wheels is unknown, expected some of "),
    ):
        done = graph.launch(*arguments)
        assert done.returncode == 2
        assert expected in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("program", "arguments", "expected"),
    [
        (
            ("litsim_policy", "conflict"),
            ("-p", "rio:=3.0"),
            "conflict: unknown parameter rio (near: region, horizon); expected approach_time, ",
        ),
        (
            ("litsim_policy", "conflict"),
            ("-p", "horizon:=-1"),
            "conflict: parameter horizon is -1, expected a number of at least 0.1 and at most 60 [s]",
        ),
        (
            ("litsim_policy", "ego"),
            ("-p", "driver:=perturbed", "-p", "time:=[2, 1]"),
            "ego: parameter time is (2.0, 1.0), expected the earliest before the latest",
        ),
        (("litsim_sim", "live"), ("-p", "rate:=3.0"), "live: unknown parameter rate; expected none"),
        (("litsim_sim", "recorder"), ("-p", "output:=5"), "recorder: parameter output is 5, expected a text"),
        (
            ("litsim_sim", "bridge"),
            ("-p", "mode:=fast"),
            "bridge: parameter mode is 'fast', expected one of lockstep, ",
        ),
        (
            ("litsim_sim", "bridge"),
            ("-p", "answer_timeout_s:=-1.0"),
            "answer_timeout_s is -1.0, expected a number of m",
        ),
        (("litsim_policy", "ego"), ("--fast",), "ego: unknown argument"),
        (("litsim_policy", "ego"), ("-p", "driver:=ghost"), "egos: no installed package has ghost; expected bat, idm"),
    ],
)
def test_parameters(graph: Any, program: tuple[str, str], arguments: tuple[str, ...], expected: str) -> None:
    done = graph.finish(graph.start_node(*program, *arguments))
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert expected in line


def start_graph(graph: Any, *without: str, odd: str = "", **bridge: Any) -> tuple[Any, Any, dict[str, Any]]:
    """Every node one by one, but for those in `without`, or an odd conflict stage: bridge, recorder, stages."""
    programs = {
        "predictor": ("litsim_predictor", "predictor"),
        "conflict": ("litsim_policy", "conflict"),
        "policy": ("litsim_policy", "policy"),
        "ego": ("litsim_policy", "ego"),
    }
    stages = {name: graph.start_node(*program) for name, program in programs.items() if name not in without}
    if odd:
        stages["conflict"] = graph.start_script("odd_stage.py", odd)
    recorder = graph.start_node("litsim_sim", "recorder", output=graph.folder / "run")
    for node in (*stages.values(), recorder):
        assert "waiting for a run on /litsim/run_info" in node.stderr.readline()
    parameters = {"scenario": graph.scenario(), "progress": "none"} | bridge
    return graph.start_node("litsim_sim", "bridge", **parameters), recorder, stages


def error_of(graph: Any, bridge: Any) -> str:
    """The one error of a bridge that gave up."""
    done = graph.finish(bridge)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    return line


def test_stage_that_is_not_there_is_named(graph: Any) -> None:
    bridge, recorder, stages = start_graph(graph, "conflict", handshake_timeout_s=HANDSHAKE_S)
    line = error_of(graph, bridge)
    assert line.startswith("error: conflict: no READY for run short-idm-litsim-13-0-")
    assert line.endswith(
        f" on /litsim/status within {HANDSHAKE_S:g} s; is the node running in ROS_DOMAIN_ID {graph.domain}?"
    )
    assert graph.finish(recorder).returncode == 0
    assert all(stage.poll() is None for stage in stages.values())  # they wait for the next run


def test_stage_that_never_answers_is_named(graph: Any) -> None:
    bridge, recorder, _ = start_graph(graph, "conflict", odd="mute", handshake_timeout_s=HANDSHAKE_S)
    line = error_of(graph, bridge)
    assert line == f"error: no answer to step 0 on /litsim/controls within {HANDSHAKE_S:g} s; silent: conflict"
    assert graph.finish(recorder).returncode == 0


def test_stage_that_fails_is_quoted_in_one_line(graph: Any) -> None:
    bridge, recorder, stages = start_graph(graph, "conflict", odd="broken")
    line = error_of(graph, bridge)
    assert line.startswith("error: conflict: step 5: ZeroDivisionError: ")
    assert "(odd_stage.py, line " in line
    assert graph.finish(recorder).returncode == 0
    status, said = graph.end(stages["conflict"], signal.SIGINT)
    assert status == 0
    assert said.count("Traceback") == 1  # in the log of the stage alone


def test_nodes_alone_end_at_once(graph: Any) -> None:
    for program, number, expected in (
        (("litsim_sim", "bridge"), signal.SIGINT, 130),
        (("litsim_sim", "recorder"), signal.SIGINT, 130),
        (("litsim_policy", "conflict"), signal.SIGTERM, 0),
    ):
        node = graph.start_node(*program)
        assert "waiting for " in node.stderr.readline()
        status, said = graph.end(node, number)
        assert status == expected
        assert "Traceback" not in said
