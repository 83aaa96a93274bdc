"""The commands of docs/recording.md that start the nodes one by one make the run that one process makes.

The stages serve one run after the other.
"""

import json
import re
import shlex
import signal
from pathlib import Path
from typing import Any

import yaml

from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.core.plugins import STAGES, package_of
from litsim_sim.core.stages import EGO, POLICY
from litsim_sim.record.digest import RunDigest
from litsim_sim.record.run import read_run
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.simulation import Simulation

PAGE = Path(__file__).resolve().parents[2] / "docs/recording.md"


def commands() -> list[list[str]]:
    """Arguments of the commands of the page's section, without ``./litsim``."""
    section = PAGE.read_text().partition("### Node by node")[2].partition("## What is there")[0]
    (block,) = re.findall(r"```bash\n(.*?)```", section, re.DOTALL)
    return [shlex.split(line)[1:] for line in block.splitlines()]


def digest_of(bag: Path, recorder: Any, bridge: Any) -> str:
    """The digest of a run that its recorder and its bridge bring to an end."""
    assert bridge.returncode == 0, bridge.stderr
    assert recorder.returncode == 0, recorder.stderr
    metrics = compute_metrics(read_run(bag))
    assert metrics["valid"], metrics["why"]
    return str(metrics["digest"])


def test_six_commands_make_the_run_of_one_process_and_their_stages_the_next(graph: Any, recorded: Any) -> None:
    domain = {"ROS_DOMAIN_ID": str(graph.domain)}
    argv = commands()
    assert [name for name, *_ in argv] == ["predictor", "conflict", "policy", "ego", "recorder", "bridge"]
    nodes = {}
    for name, *options in argv:
        package = package_of(STAGES, POLICY if name == EGO else name)
        nodes[name] = graph.start_program(package, name, *options, **domain)
    bridge, recorder = graph.finish(nodes.pop("bridge")), graph.finish(nodes.pop("recorder"))
    given = dict(yaml.safe_load(word.replace(":=", ": ")).popitem() for word in argv[-1] if ":=" in word)
    total = RunDigest()
    for result in Simulation.of(RunPlan.load(given["scenario"], given["ego"], given["policy"])).steps():
        total.update(result.table, result.controls, result.ego)
    assert digest_of(graph.folder / "bags/nodes", recorder, bridge) == total.hexdigest()

    next_recorder = graph.start_node("litsim_sim", "recorder", output=graph.folder / "next")
    bridge = graph.finish(graph.start_node("litsim_sim", "bridge", scenario=graph.scenario(), progress="none"))
    digest = digest_of(graph.folder / "next", graph.finish(next_recorder), bridge)
    assert digest == json.loads((recorded("idm", "litsim").bag / "metrics.json").read_text())["digest"]
    for node in nodes.values():
        status, said = graph.end(node, signal.SIGINT)
        assert status == 0
        assert "waiting for a run on /litsim/run_info" in said
        assert said.count("is over") == 2
        assert "Traceback" not in said
