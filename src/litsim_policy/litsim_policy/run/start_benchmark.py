"""How long a run takes from its launcher to its first step, beside importing the libraries that its nodes use."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from litsim_policy.run.benchmark import EGO, POLICY, execute, write_scenario
from litsim_sim.core.stages import BRIDGE
from litsim_sim.launch.executables import find_executable
from litsim_sim.record.run import Run, read_run

LIBRARIES = ("numpy", "shapely", "pyarrow", "pydantic", "numba", "libsumo", "rclpy.node")
"""What the processes of this run import, one or all of them, with what these import; none that no process imports."""
FIRST_STEP, SLOWEST, RATIO = "launcher to first step", "slowest import", "first step / slowest import"
SECONDS = 4.0  # simulated, 3 s of history included

Start = dict[str, float]
"""Of one repetition: :data:`FIRST_STEP` [s], and the import of each of :data:`LIBRARIES` on its own [s]."""


def measure_start(folder: Path, agents: int, repeats: int, advance: Callable[[], object]) -> list[Start]:
    """Import the libraries, each in a process of its own, and launch a run of benchmark traffic, in turns.

    Raises:
        InputError: a run failed, or a library cannot be imported.
    """
    scenario = write_scenario(folder, agents, SECONDS)
    found = []
    for _ in range(repeats):
        bare = _import_time("sys")
        start = {library: _import_time(library) - bare for library in LIBRARIES}
        found.append(start | {FIRST_STEP: time_to_first_step(scenario, folder / "bag")})
        advance()
    return found


def time_to_first_step(scenario_file: Path, bag: Path) -> float:
    """Seconds from the start of the launcher to when the bridge has published step 0.

    Raises:
        InputError: the run failed.
    """
    command = ["--quiet", "--no-analyze", "--overwrite", "--out", str(bag), "--scenario", str(scenario_file)]
    program = find_executable("litsim_sim", "launch")
    begin = time.perf_counter()
    execute(program, *command, "--ego", EGO, "--policy", POLICY)
    return first_step(read_run(bag)) - begin


def first_step(run: Run) -> float:
    """When step 0 of a recorded run was published, on the clock of the performance counter [s]."""
    return run.marks[BRIDGE][0]["shown"]


def start_rows(found: Sequence[Mapping[str, float]]) -> Iterator[list[str]]:
    """Rows of the table: what, and median, least and most of the repetitions; the ratios are of each repetition."""
    names = [*sorted(LIBRARIES, key=lambda name: -statistics.median(each[name] for each in found))]
    for name in names:
        yield [f"import {name}, s", _spread([each[name] for each in found])]
    slowest = [max(each[name] for name in LIBRARIES) for each in found]
    first = [each[FIRST_STEP] for each in found]
    yield [f"{SLOWEST}, s", _spread(slowest)]
    yield [f"{FIRST_STEP}, s", _spread(first)]
    yield [RATIO, _spread([a / b for a, b in zip(first, slowest, strict=True)])]


def _import_time(library: str) -> float:
    """Seconds of a process that imports `library` and ends."""
    begin = time.perf_counter()
    execute(Path(sys.executable), "-c", f"import {library}")
    return time.perf_counter() - begin


def _spread(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"
