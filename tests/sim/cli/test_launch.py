"""What the launcher has to import before it can start the nodes: all of them wait for it."""

from __future__ import annotations

import subprocess
import sys

NOT_NEEDED = ("matplotlib", "onnxruntime", "pandas", "scipy.linalg", "scipy.sparse", "scipy.special", "torch")
CHECK = f"""
import sys
from pathlib import Path
from litsim_sim.cli import launch
from litsim_sim.launch.nodes import GraphOptions, nodes_of
from litsim_sim.nodes.shared import prepare_nodes
arguments = launch.parser().parse_args(["--ego", "idm", "--policy", "litsim"])
plan = launch.plan_of(arguments)
nodes_of(plan, GraphOptions(arguments.scenario, Path("out")))
plan.scenario.recording.to_parquet()
prepare_nodes()
print(*[name for name in {NOT_NEEDED} if name in sys.modules])
"""


def test_the_launcher_imports_no_library_that_it_does_not_need() -> None:
    done = subprocess.run([sys.executable, "-c", CHECK], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr
