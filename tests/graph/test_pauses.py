"""Processes that are stopped, and continued in time or not; of bridge and recorder, see test_processes.py."""

import json
import re
import signal
import time
from typing import Any

from litsim_sim.record.run import read_run
from patience import wait_for

AT = 20  # step at which the run waits for its ego while somebody is stopped
PAUSE_S = 3.0  # [s]; who does not read for 1 s has been given up by Fast DDS's shared memory
IMPATIENT = 7.0  # [s] for answers, where one does not come


def test_who_is_stopped_and_goes_on_in_time_does_not_end_the_run(graph: Any) -> None:
    bag, go = graph.folder / "run", graph.folder / "go"
    graph.start_script("external_ego.py", "--hold-at", AT, "--until", go)
    words = ("--scenario", graph.scenario(), "--ego", "external", "--policy", "litsim", "--out", bag)
    launcher = graph.start_launch(*words, "--domain-id", graph.domain)
    log = bag / "log/bridge.log"
    wait_for(f"step {AT}", lambda: log.is_file() and f"step {AT}: waiting for /litsim/ego/" in log.read_text())
    for executable in ("stages", "recorder"):
        graph.signal(executable, signal.SIGSTOP)
    go.touch()
    time.sleep(PAUSE_S)
    for executable in ("stages", "recorder"):
        graph.signal(executable, signal.SIGCONT)
    done = graph.finish(launcher)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((bag / "metrics.json").read_text())
    assert (metrics["valid"], metrics["lockstep"]["missed"], metrics["lockstep"]["gaps"]) == (True, 0, 0)


def test_an_ego_of_its_own_that_is_stopped_for_good_ends_the_run(graph: Any) -> None:
    """The recorder holds the run up until then: the bridge is as far ahead of it as it may be."""
    go = graph.folder / "go"
    recorder = graph.start_script("slow_recorder.py", go, "--ros-args", "-p", f"output:={graph.folder / 'run'}")
    ego = graph.start_node("litsim_policy", "ego")
    parameters = {"scenario": graph.scenario(simulation_s=8.0), "policy": "replay", "progress": "none"}
    bridge = graph.start_node("litsim_sim", "bridge", **parameters, answer_timeout_s=IMPATIENT)
    assert any("waiting for /litsim/recorded of the recorder" in line for line in bridge.stderr)
    ego.send_signal(signal.SIGSTOP)
    go.touch()
    done = graph.finish(bridge)
    assert done.returncode == 1
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    assert re.fullmatch(r"error: no answer to step \d+ on /litsim/ego/control within 7 s(; silent: ego)?", line), line
    assert graph.finish(recorder).returncode == 0
    assert read_run(graph.folder / "run").complete
    ego.send_signal(signal.SIGCONT)
