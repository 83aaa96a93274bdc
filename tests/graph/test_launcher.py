"""The launcher ends every process that it has started, whatever happens, and says what happened."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from ament_index_python.packages import get_package_prefix

from litsim_sim.core.stages import StageState
from litsim_sim.record.run import read_run

LONG = {"simulation_s": 24.0}  # for runs that are ended before it is over
AS_OTHERS = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"] if os.geteuid() == 0 else []
"""Runs a command as if root could write no more than the mode of a folder says."""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_run_is_recorded_up_to_there(graph: Any, number: signal.Signals) -> None:
    bag = graph.folder / "run"
    launcher = graph.start_launch("--mode", "realtime", "--scenario", graph.scenario(**LONG), "--out", bag)
    graph.wait_under_way(bag)
    assert len(graph.running()) == 4  # six nodes, of which four share a process, and the launcher
    status, said = graph.end(launcher, number)
    assert status == 130
    assert "interrupted: ending the graph" in said
    assert "Traceback" not in said
    assert not graph.running()
    run = read_run(bag)
    assert run.complete
    assert [table.step for table in run.tables] == list(range(len(run.tables)))
    last = run.statuses[-1]
    assert (last.stage, last.state, last.text) == ("bridge", StageState.FAILED, "interrupted")
    logs = {path.stem: path.read_text() for path in (bag / "log").iterdir()}
    assert logs.keys() == {"bridge", "recorder", "stages"}
    assert not [name for name, text in logs.items() if "Traceback" in text or "ERROR" in text]


def test_children_of_a_killed_launcher_end_by_themselves(graph: Any) -> None:
    bag = graph.folder / "run"
    launcher = graph.start_launch("--mode", "realtime", "--scenario", graph.scenario(**LONG), "--out", bag)
    graph.wait_under_way(bag)
    graph.end(launcher, signal.SIGKILL)
    graph.wait("the nodes to end", lambda: not graph.running())
    graph.wait("the end of the record", lambda: read_run(bag).complete)


def test_interrupt_before_the_run_has_begun(graph: Any) -> None:
    launcher = graph.start_launch("--scenario", graph.scenario(), "--out", graph.folder / "run")
    graph.wait("the first node", lambda: len(graph.running()) > 2)
    status, said = graph.end(launcher)
    assert status == 130
    assert "Traceback" not in said
    assert not graph.running()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_dead_node_is_named(graph: Any, number: signal.Signals) -> None:
    bag = graph.folder / "run"
    launcher = graph.start_launch("--mode", "realtime", "--scenario", graph.scenario(**LONG), "--out", bag, "--apart")
    graph.wait_under_way(bag)
    graph.signal("conflict", number)
    done = graph.finish(launcher)
    assert done.returncode == 1
    (error,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    expected = {
        signal.SIGKILL: "node conflict was ended by SIGKILL",  # it could tell nobody
        signal.SIGTERM: "conflict: the node was ended",
    }
    assert expected[number] in error
    assert str(bag / "log") in error
    assert "Traceback" not in done.stderr
    assert not graph.running()
    assert read_run(bag).complete


def test_existing_recording_is_replaced_only_on_demand(graph: Any) -> None:
    bag = graph.folder / "1e3"  # names that YAML would not read as text
    (bag / "log").mkdir(parents=True)
    for name in ("old_0.mcap", "metrics.json", "log/policy.log"):
        (bag / name).write_text("old")
    graph.scenario().rename(graph.folder / "a: 'b'.yaml")
    arguments = ("--scenario", "a: 'b'.yaml", "--out", "1e3", "--policy", "replay", "--quiet")
    refused = graph.launch(*arguments)
    assert refused.returncode == 2
    assert refused.stderr == "error: 1e3: holds a recording already; give another folder (out), or overwrite it\n"
    assert (bag / "old_0.mcap").read_text() == "old"

    replaced = graph.launch(*arguments, "--overwrite")
    assert (replaced.returncode, replaced.stdout, replaced.stderr) == (0, "", "")
    assert [path.name for path in bag.glob("*.mcap")] == ["1e3_0.mcap"]
    assert "old" not in (bag / "metrics.json").read_text()
    assert not (bag / "log/policy.log").exists()


def test_folder_that_cannot_be_written_is_refused(graph: Any, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = graph.launch("--scenario", graph.scenario(), "--out", tmp_path / "file" / "run")
    assert done.returncode == 2
    assert done.stderr == f"error: {tmp_path}/file/run: cannot be written: Not a directory\n"


@pytest.mark.skipif(AS_OTHERS != [] and not shutil.which("setpriv"), reason="root writes everywhere (no setpriv)")
def test_read_only_folder_is_refused(graph: Any, tmp_path: Path) -> None:
    (tmp_path / "shut").mkdir(mode=0o500)
    program = Path(get_package_prefix("litsim_sim")) / "lib/litsim_sim/launch"
    command = [*AS_OTHERS, program, "--scenario", graph.scenario(), "--out", tmp_path / "shut/run"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 2
    assert done.stderr == f"error: {tmp_path}/shut/run: cannot be written: Permission denied\n"
