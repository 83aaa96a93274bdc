"""What the launcher and its nodes have to import before the first step, which waits for all of it."""

from __future__ import annotations

import subprocess
import sys

COMPILER = "numba.np.arraymath"  # which numba imports before it compiles anything
NOT_NEEDED = ("matplotlib", "onnxruntime", "pandas", "scipy.linalg", "scipy.sparse", "scipy.special", "torch", COMPILER)
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
import litsim_policy.driving.stages_node, litsim_policy.ego.node, litsim_sim.nodes.recorder
print(*[name for name in {NOT_NEEDED} if name in sys.modules])
"""


def test_neither_the_launcher_nor_its_nodes_import_a_library_that_they_do_not_need() -> None:
    done = subprocess.run([sys.executable, "-c", CHECK], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr
