"""`compile`: compile all kernels now, so that no later start waits for that."""

from __future__ import annotations

import argparse
import os
import pkgutil
import time

from tqdm import tqdm

from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import at_least_one, program
from litsim_sim.kernels.ahead_of_time import compile_kernels, import_kernels, missing_kernels
from litsim_sim.kernels.compiled import load_kernels

PREFIX = "litsim_"  # of the names of packages that can hold kernels
PROCESSES_MAX = 8  # by default: the longest chain of kernels is a fifth of the work, and each process takes memory


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_sim compile``."""
    p = Parser(prog="compile", description=__doc__)
    p.add_argument(
        "--processes",
        type=at_least_one,
        default=min(len(os.sched_getaffinity(0)), PROCESSES_MAX),
        help=f"kernels to compile at once; default: as many as processors, at most {PROCESSES_MAX}",
    )
    return p


@program
def main() -> None:
    """Entry point of ``ros2 run litsim_sim compile``."""
    processes, begin = parser().parse_args().processes, time.perf_counter()
    packages = sorted(module.name for module in pkgutil.iter_modules() if module.name.startswith(PREFIX))
    modules = [module for package in packages for module in import_kernels(package)]
    missing = missing_kernels()
    with tqdm(total=len(missing), unit="kernel", disable=None) as bar:  # on a terminal
        for _ in compile_kernels(missing, processes):
            bar.update()
    load_kernels()
    print(f"compile: {len(modules)} modules of kernels ready in {time.perf_counter() - begin:.1f} s")


if __name__ == "__main__":
    main()
