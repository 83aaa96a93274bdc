"""Benchmark of the start: from the launcher to the first step, compared with the imports of the nodes' libraries."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from litsim_eval.benchmark.steps import Sample, execute, launch, spread, write_scenario
from litsim_sim.core.stages import BRIDGE
from litsim_sim.record.run import read_run

LIBRARIES = ("numpy", "shapely", "pyarrow", "pydantic", "numba", "libsumo", "rclpy.node")
"""Slow imports of the processes of this run, each with its own dependencies."""
TORCH = "torch"
"""The slowest import of runs when a target was set for their start; none imports it now. Timed if it is installed."""
FIRST_STEP, SLOWEST, RATIO = "launcher to first step", "slowest import", "first step / slowest import"
SECONDS = 4.0  # [s] simulated time, 3 s of history included


def measure_start(folder: Path, agents: int, repeats: int, advance: Callable[[], object]) -> list[Sample]:
    """Times, `repeats` times, the import of each library in a new process, and the launch of a run [s].

    The libraries are :data:`LIBRARIES`, and :data:`TORCH` where it is installed.

    Raises:
        InputError: a run failed, or a library cannot be imported.
    """
    scenario = write_scenario(folder, agents, SECONDS)
    libraries = [*LIBRARIES, *([TORCH] if find_spec(TORCH) else [])]
    starts = []
    for _ in range(repeats):
        bare = _import_time("sys")
        start = {library: _import_time(library) - bare for library in libraries}
        starts.append(start | {FIRST_STEP: time_to_first_step(scenario, folder / "bag")})
        advance()
    return starts


def time_to_first_step(scenario_file: Path, bag: Path) -> float:
    """Returns the time [s] from the start of the launcher until the bridge has published step 0.

    Raises:
        InputError: the run failed.
    """
    begin = time.perf_counter()
    launch(scenario_file, bag, "--no-analyze")
    return read_run(bag).marks[BRIDGE][0]["shown"] - begin


def start_rows(starts: Sequence[Sample]) -> Iterator[list[str]]:
    """Yields rows of the table: name, and median (minimum to maximum); ratios are within repetitions."""
    slowest = [max(start[name] for name in LIBRARIES) for start in starts]
    figures = [
        start | {SLOWEST: most, RATIO: start[FIRST_STEP] / most} for start, most in zip(starts, slowest, strict=True)
    ]
    for name in sorted(LIBRARIES, key=lambda name: -statistics.median(start[name] for start in starts)):
        yield [f"import {name}, s", spread(figures, name)]
    yield [f"{SLOWEST}, s", spread(figures, SLOWEST)]
    yield [f"{FIRST_STEP}, s", spread(figures, FIRST_STEP)]
    yield [RATIO, spread(figures, RATIO)]
    if all(TORCH in start for start in starts):
        ratio = f"{FIRST_STEP} / import {TORCH}"
        yield [f"import {TORCH}, which no run does, s", spread(figures, TORCH)]
        yield [ratio, spread([{ratio: start[FIRST_STEP] / start[TORCH]} for start in starts], ratio)]


def _import_time(library: str) -> float:
    """Returns the duration [s] of a process that imports `library` and ends."""
    begin = time.perf_counter()
    execute(Path(sys.executable), "-c", f"import {library}")
    return time.perf_counter() - begin
