"""Compilation of kernels ahead of time, several at once."""

from __future__ import annotations

import multiprocessing
import pkgutil
import re
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from graphlib import TopologicalSorter
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from litsim_sim.kernels.compiled import KERNELS, Kernel, announce, run_kernels

MARK = re.compile(r"^@kernel$", re.MULTILINE)  # occurs in the source of every module with kernels


def import_kernels(package: str) -> list[str]:
    """Import the modules of a package that have kernels; return their names."""
    names = []
    for module in pkgutil.walk_packages(import_module(package).__path__, f"{package}."):
        spec = find_spec(module.name)
        if spec is not None and spec.origin is not None and MARK.search(Path(spec.origin).read_text("utf-8")):
            import_module(module.name)
            names.append(module.name)
    return names


def missing_kernels() -> list[Kernel]:
    """Returns the kernels of a run whose machine code is not on disk but could be, and all that they call."""
    missing = [kernel for kernel in run_kernels() if kernel.file is not None and not kernel.file.exists()]
    for kernel in missing:  # grows
        missing += [called for called in kernel.uses if called not in missing]
    return missing


def compile_kernels(missing: Sequence[Kernel], processes: int) -> Iterator[None]:
    """Compile the :func:`missing_kernels` and keep their machine code; yield after each.

    A kernel is compiled once the kernels that it calls are on disk, by one of `processes` copies of this process.
    """
    if not missing:
        return
    announce()
    order = TopologicalSorter({kernel: kernel.uses for kernel in missing})
    order.prepare()
    fork = multiprocessing.get_context("fork")  # the copies have all kernels
    with ProcessPoolExecutor(processes, fork, signal.signal, (signal.SIGINT, signal.SIG_DFL)) as pool:
        running: dict[Future[None], Kernel] = {}
        while order.is_active():
            running |= {pool.submit(_compile, KERNELS.index(kernel)): kernel for kernel in order.get_ready()}
            for job in wait(running, return_when=FIRST_COMPLETED).done:
                job.result()
                order.done(running.pop(job))
                yield


def _compile(number: int) -> None:
    """Compile one of all kernels, and keep its machine code."""
    kernel = KERNELS[number]
    kernel.loaded if kernel in run_kernels() else kernel.compiled
