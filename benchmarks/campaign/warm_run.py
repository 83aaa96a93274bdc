"""What a run with a stack that stays up costs of the processor, by part: the median of runs, without the stack itself.

    ./litsim exec python benchmarks/campaign/warm_run.py

The runs are those of `evaluate --warm` with `examples/minimal_ads.py` and `replay`; the first is left out.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from litsim_eval.campaign.case import cases_of
from litsim_eval.campaign.suite import EgoSetup, Suite
from litsim_eval.report import recorded
from litsim_eval.runs import warm_graph
from litsim_eval.runs.warm_graph import WarmGraph
from litsim_sim.nodes.bridge import Bridge
from litsim_sim.nodes.bridge_node import BridgeNode
from litsim_sim.nodes.recorder import RecorderNode
from litsim_sim.scenario.policies import REPLAY
from litsim_sim.scenario.run_info import EXTERNAL

STACK = Path(__file__).parents[2] / "examples/minimal_ads.py"
STEPS, ALL = "steps", "all"
PARTS: tuple[tuple[str, Any, str], ...] = (
    ("plan", warm_graph, "plan_of"),
    ("nodes", warm_graph, "BridgeNode"),
    ("nodes", warm_graph, "RecorderNode"),
    ("nodes", BridgeNode, "destroy_node"),
    ("nodes", RecorderNode, "destroy_node"),
    ("set-up", Bridge, "_set_up"),
    ("handshake", Bridge, "_handshake"),
    (STEPS, Bridge, "_all_steps"),
    ("end", Bridge, "_conclude"),
    ("seal", warm_graph, "write_seal"),
    ("reading", recorded, "read_run"),
    ("measures", recorded, "compute_metrics"),
    ("picture", recorded, "write_thumbnail"),
    ("page", recorded, "render"),
)
"""Names of the parts, and the functions that make them."""


def timed(name: str, function: Callable[..., Any], taken: dict[str, float]) -> Callable[..., Any]:
    """Returns `function`, whose time of the processor [s] is added to what `name` has taken."""

    def call(*arguments: Any, **named: Any) -> Any:
        begin = time.process_time()
        try:
            return function(*arguments, **named)
        finally:
            taken[name] += time.process_time() - begin

    return call


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--suite", default="small")
    arguments = parser.parse_args()
    ego = EgoSetup(name=EXTERNAL, kind=EXTERNAL, command=[sys.executable, str(STACK)])
    suite = Suite.load(arguments.suite).model_copy(update={"egos": [ego], "policies": [REPLAY]})
    cases = cases_of(suite, graph=True)
    taken = defaultdict[str, float](float)
    for name, owner, function in PARTS:
        setattr(owner, function, timed(name, getattr(owner, function), taken))
    rows: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder, WarmGraph() as graph:
        run = timed(ALL, graph.run, taken)
        chosen = [cases[k * len(cases) // arguments.runs % len(cases)] for k in range(arguments.runs)]
        for case in tqdm([chosen[0], *chosen], unit="run"):
            taken.clear()
            out = Path(folder) / case.id
            out.mkdir(exist_ok=True)
            if failure := run(case, out):
                sys.exit(f"{case.name}: {failure}")
            rows.append(dict(taken))
    del rows[0]
    for row in rows:
        row["the rest"] = 2 * row[ALL] - sum(row.values())
        row["all beside steps"] = row[ALL] - row[STEPS]
    for name in rows[0]:
        values = sorted(row[name] for row in rows)
        print(f"| {name} | {statistics.median(values):.3f} ({values[0]:.3f} to {values[-1]:.3f}) |")


if __name__ == "__main__":
    main()
