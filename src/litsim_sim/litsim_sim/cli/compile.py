"""`compile`: compile all kernels now, so that no later start waits for that."""

from __future__ import annotations

import argparse
import time
from importlib.util import find_spec

from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program
from litsim_sim.core.compiled import compile_package

PACKAGES = ("litsim_sim", "litsim_predictor", "litsim_policy")
"""All that can hold kernels; this package is below the others and imports nothing of them by itself."""


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_sim compile``: none."""
    return Parser(prog="compile", description=__doc__)


@program
def main() -> None:
    """Entry point of ``ros2 run litsim_sim compile``."""
    parser().parse_args()
    begin = time.perf_counter()
    found = [module for package in PACKAGES if find_spec(package) for module in compile_package(package)]
    print(f"compile: {len(found)} modules of kernels ready in {time.perf_counter() - begin:.1f} s")


if __name__ == "__main__":
    main()
