"""Memory of a long run and its growth, in process and in each process of the graph."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from litsim_eval.benchmark.steps import EGO, IN_PROCESS, POLICY, write_scenario
from litsim_eval.runs.runner import Runner
from litsim_sim.core.errors import InputError
from litsim_sim.launch.nodes import find_executable
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.sumo import SumoMirror

PERIOD_S = 0.5  # [s] between two samples of a graph's processes
EVERY = 50  # steps between two samples in process
SETTLED = 0.25  # share of a run after which memory should no longer grow
LAUNCHER = "launch"
NODES = "/lib/litsim_"  # part of the path of every LitSim executable


@dataclass
class Memory:
    """Samples of a process: share of the run done, and resident memory [MB]."""

    share: list[float] = field(default_factory=list)
    resident: list[float] = field(default_factory=list)

    def at(self, share: float) -> float:
        """Returns the resident memory [MB] after `share` of the run."""
        return float(np.interp(share, self.share, self.resident))

    def slope(self, minutes: float) -> float:
        """Returns the growth [MB per simulated minute] after SETTLED in a run of `minutes`, by a fitted line."""
        share, resident = np.array(self.share), np.array(self.resident)
        settled = share >= SETTLED
        return float(np.polyfit(share[settled] * minutes, resident[settled], 1)[0])


def measure_memory(agents: int, minutes: float) -> dict[str, Memory]:
    """Runs benchmark traffic for `minutes` in process, keeping no results, then over the graph with recording.

    Returns:
        memory by process.

    Raises:
        InputError: a run failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        scenario = write_scenario(Path(folder), agents, 60.0 * minutes)
        context = multiprocessing.get_context("spawn")  # a process of its own, to measure its memory alone
        with ProcessPoolExecutor(1, mp_context=context) as process:
            in_process = process.submit(memory_in_process, scenario).result()
        return {IN_PROCESS: in_process} | memory_of_graph(scenario, Path(folder) / "bag")


def memory_in_process(scenario_file: Path) -> Memory:
    """Returns memory of this process while it runs a scenario and keeps no results."""
    scenario, memory = Scenario.load(scenario_file), Memory()
    mirror = SumoMirror(scenario.net_path, scenario.seed, scenario.signals)
    for now in Runner(RunPlan(scenario, EGO, POLICY), mirror).steps():
        if now.table.step % EVERY == 0:
            memory.share.append(now.table.step / scenario.total_steps)
            memory.resident.append(resident_mb(os.getpid()))
    return memory


def memory_of_graph(scenario_file: Path, bag: Path) -> dict[str, Memory]:
    """Returns memory of each process of a graph from step 0 of a run on, recorded to `bag`.

    Raises:
        InputError: the run failed.
    """
    command = [find_executable("litsim_sim", LAUNCHER), "--no-analyze", "--out", bag, "--scenario", scenario_file]
    environment = {key: value for key, value in os.environ.items() if key != "ROS_DOMAIN_ID"}
    log = bag.with_suffix(".log")
    samples: list[tuple[float, dict[str, float]]] = []
    with log.open("w") as stream:
        launcher = subprocess.Popen(
            [*map(str, command), "--ego", EGO, "--policy", POLICY], stdout=stream, stderr=stream, env=environment
        )
        try:
            while launcher.poll() is None:
                if "step/s" in log.read_text(errors="replace"):  # its progress bar
                    resident = {name: resident_mb(process) for name, process in children(launcher.pid).items()}
                    samples.append((time.monotonic(), resident))
                time.sleep(PERIOD_S)
        finally:
            launcher.terminate()
            launcher.wait()
    if launcher.returncode != 0 or not samples:
        raise InputError(f"launch ended with status {launcher.returncode}: {log.read_text()[-500:]}")
    whole = {
        name for name in samples[0][1] if all(name in resident for _, resident in samples[: len(samples) * 9 // 10])
    }
    samples = [
        (when, resident)
        for when, resident in samples
        if whole <= resident.keys() and all(resident[name] for name in whole)
    ]
    first, last = samples[0][0], samples[-1][0]
    share = [(when - first) / (last - first) for when, _ in samples]
    return {name: Memory(share, [resident[name] for _, resident in samples]) for name in sorted(whole)}


def children(parent: int) -> dict[str, int]:
    """Returns ids of the LitSim processes that the process `parent` has started, by the name of their executable."""
    processes = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
        except OSError:  # it has ended
            continue
        program = next((word for word in words if NODES in word), "")
        if int(fields[1]) == parent and program:
            processes[Path(program).name] = int(folder.name)
    return processes


def resident_mb(process: int) -> float:
    """Returns the resident memory of a process [MB]; 0 if it has ended."""
    try:
        pages = int((Path("/proc") / str(process) / "statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def memory_rows(found: Mapping[str, Memory], minutes: float) -> Iterator[list[str]]:
    """Yields rows of the table: process, memory [MB] at the start, when settled, at the end; growth [MB per minute]."""
    for name, memory in found.items():
        figures = (memory.at(0.0), memory.at(SETTLED), memory.at(1.0))
        yield [name, *(f"{figure:.1f}" for figure in figures), f"{memory.slope(minutes):+.2f}"]
