"""Benchmark of the start: from the launcher to the first step, compared with the imports of the nodes' libraries."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from litsim_eval.benchmark.steps import EGO, POLICY, execute, write_scenario
from litsim_sim.core.stages import BRIDGE
from litsim_sim.launch.nodes import find_executable
from litsim_sim.record.run import Run, read_run

LIBRARIES = ("numpy", "shapely", "pyarrow", "pydantic", "numba", "libsumo", "rclpy.node")
"""Slow imports of the processes of this run, each with its own dependencies."""
TORCH = "torch"
"""The slowest import of runs when a target was set for their start; none imports it now. Timed if it is installed."""
FIRST_STEP, SLOWEST, RATIO = "launcher to first step", "slowest import", "first step / slowest import"
SECONDS = 4.0  # [s] simulated time, 3 s of history included

Start = dict[str, float]
"""Times of one repetition [s]: :data:`FIRST_STEP`, and the import of each library on its own."""


def measure_start(folder: Path, agents: int, repeats: int, advance: Callable[[], object]) -> list[Start]:
    """Time, `repeats` times, the import of each library in a new process, and the launch of a run.

    The libraries are :data:`LIBRARIES`, and :data:`TORCH` where it is installed.

    Raises:
        InputError: a run failed, or a library cannot be imported.
    """
    scenario = write_scenario(folder, agents, SECONDS)
    libraries = [*LIBRARIES, *([TORCH] if find_spec(TORCH) else [])]
    found = []
    for _ in range(repeats):
        bare = _import_time("sys")
        start = {library: _import_time(library) - bare for library in libraries}
        found.append(start | {FIRST_STEP: time_to_first_step(scenario, folder / "bag")})
        advance()
    return found


def time_to_first_step(scenario_file: Path, bag: Path) -> float:
    """Time [s] from the start of the launcher until the bridge has published step 0.

    Raises:
        InputError: the run failed.
    """
    command = ["--quiet", "--no-analyze", "--overwrite", "--out", str(bag), "--scenario", str(scenario_file)]
    program = find_executable("litsim_sim", "launch")
    begin = time.perf_counter()
    execute(program, *command, "--ego", EGO, "--policy", POLICY)
    return first_step(read_run(bag)) - begin


def first_step(run: Run) -> float:
    """Time at which step 0 of a recorded run was published, by the clock of ``time.perf_counter`` [s]."""
    return run.marks[BRIDGE][0]["shown"]


def start_rows(found: Sequence[Mapping[str, float]]) -> Iterator[list[str]]:
    """Rows of the table: name, and median (minimum to maximum) of the repetitions; ratios are within repetitions."""
    names = [*sorted(LIBRARIES, key=lambda name: -statistics.median(each[name] for each in found))]
    for name in names:
        yield [f"import {name}, s", _spread([each[name] for each in found])]
    slowest = [max(each[name] for name in LIBRARIES) for each in found]
    first = [each[FIRST_STEP] for each in found]
    yield [f"{SLOWEST}, s", _spread(slowest)]
    yield [f"{FIRST_STEP}, s", _spread(first)]
    yield [RATIO, _spread([a / b for a, b in zip(first, slowest, strict=True)])]
    if all(TORCH in each for each in found):
        yield [f"import {TORCH}, which no run does, s", _spread([each[TORCH] for each in found])]
        yield [f"{FIRST_STEP} / import {TORCH}", _spread([each[FIRST_STEP] / each[TORCH] for each in found])]


def _import_time(library: str) -> float:
    """Duration [s] of a process that imports `library` and ends."""
    begin = time.perf_counter()
    execute(Path(sys.executable), "-c", f"import {library}")
    return time.perf_counter() - begin


def _spread(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"
