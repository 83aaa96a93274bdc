"""The soak computes the digests that it expects with the code of numpy that the nodes use."""

import os
import subprocess
import sys
from pathlib import Path

from litsim_sim.kernels.processor import CHOICE


def chosen_by(module: str) -> str:
    """The variables by which numpy chooses its code, as set in a new process that imports `module`."""
    environment = {name: value for name, value in os.environ.items() if name not in CHOICE}
    program = (
        f"import os, sys; sys.path.insert(0, sys.argv[1]); import {module}; print([*map(os.environ.get, {[*CHOICE]})])"
    )
    words = [sys.executable, "-c", program, str(Path(__file__).parent)]
    return subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout


def test_numpy_runs_the_code_that_it_runs_in_the_nodes() -> None:
    assert chosen_by("soak") == chosen_by("litsim_sim")
