"""The launcher ends every process that it has started, whatever happens, and says what happened."""

import os
import signal
from typing import Any

from litsim_sim.core.stages import StageState
from litsim_sim.nodes.recorder import NICENESS
from litsim_sim.record.run import read_run
from patience import wait_for

LONG = {"simulation_s": 24.0}  # for runs that are ended before it is over


def test_interrupted_run_is_recorded_up_to_there(graph: Any) -> None:
    bag = graph.folder / "run"
    launcher = graph.start_launch("--mode", "realtime", "--scenario", graph.scenario(**LONG), "--out", bag)
    graph.wait_under_way(bag)
    running = graph.running()
    assert len(running) == 4  # six nodes, of which four share a process, and the launcher
    (recorder,) = (pid for pid, line in running.items() if "/recorder " in line)
    nice = os.getpriority(os.PRIO_PROCESS, recorder) - os.getpriority(os.PRIO_PROCESS, launcher.pid)
    assert nice == NICENESS, "it lets the nodes go first that others wait for"
    status, said = graph.end(launcher)
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


def test_interrupt_before_the_run_has_begun(graph: Any) -> None:
    launcher = graph.start_launch("--scenario", graph.scenario(), "--out", graph.folder / "run")
    wait_for("the first node", lambda: len(graph.running()) > 2)
    status, said = graph.end(launcher, signal.SIGTERM)  # as Ctrl-C
    assert status == 130
    assert "Traceback" not in said
    assert not graph.running()


def test_a_node_that_is_ended_is_named(graph: Any) -> None:
    """One that is killed, which can tell nobody, is one of test_faults.py."""
    bag = graph.folder / "run"
    launcher = graph.start_launch("--mode", "realtime", "--scenario", graph.scenario(**LONG), "--out", bag, "--apart")
    graph.wait_under_way(bag)
    graph.signal("conflict", signal.SIGTERM)
    done = graph.finish(launcher)
    assert done.returncode == 1
    (error,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    assert "conflict: the node was ended" in error
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
