"""How long a step takes, in process and over the graph, with a given number of agents."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

from litsim_predictor.benchmark import columns_of_traffic
from litsim_sim.analysis.metrics import METRICS_FILE
from litsim_sim.core.errors import InputError
from litsim_sim.launch.executables import find_executable
from litsim_sim.scenario.scenario import packaged

NET = "us101_like"


@dataclass(frozen=True)
class Sample:
    """Time per step [ms] of one pair of runs, and what the graph makes of a second of wall time.

    Attributes:
        realtime_factor: of the graph, simulated time over wall time.
    """

    in_process: float
    graph: float
    realtime_factor: float

    @property
    def ratio(self) -> float:
        """Graph over in process."""
        return self.graph / self.in_process


def write_scenario(folder: Path, agents: int, seconds: float) -> Path:
    """A scenario on :func:`columns_of_traffic`; the ego is in the middle of the columns.

    An ego that keeps a longer headway falls back in it, and those behind it are taken over.
    """
    columns_of_traffic(agents, seconds).write(folder / f"{agents}.parquet")
    values = {
        "name": f"bench_{agents}",
        "recording": f"{agents}.parquet",
        "net": str(packaged(f"nets/{NET}.net.xml")),
        "ego": agents // 2 + 1,
        "simulation_s": seconds - 3.0,
    }
    path = folder / f"{agents}.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


def measure(folder: Path, agents: int, seconds: float, repeats: int, done: Callable[[], object]) -> list[Sample]:
    """Pairs of runs, in process and over the graph with recording in turn, so that both meet the same machine.

    Raises:
        InputError: a run failed.
    """
    scenario = write_scenario(folder, agents, seconds)
    samples = []
    for _ in range(repeats):
        out = folder / "bag"
        walls = []
        for command in (
            ["litsim_policy", "run", "--json", str(folder / METRICS_FILE)],
            ["litsim_sim", "launch", "--quiet", "--overwrite", "--out", str(out)],
        ):
            _execute([*command, "--scenario", str(scenario), "--ego", "idm", "--policy", "litsim"])
            done()
        for path in (folder / METRICS_FILE, out / METRICS_FILE):
            metrics = json.loads(path.read_text())
            walls.append((1e3 * metrics["timing"]["wall_s"] / (metrics["steps"] + 1), metrics["timing"]))
        samples.append(Sample(walls[0][0], walls[1][0], walls[1][1]["realtime_factor"]))
    return samples


def rows(samples: list[Sample]) -> Iterator[tuple[str, str]]:
    """Measures of one number of agents as `median (minimum to maximum)`."""
    for name in ("in_process", "graph", "ratio", "realtime_factor"):
        values = [getattr(sample, name) for sample in samples]
        yield name, f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def _execute(command: list[str]) -> None:
    package, executable, *arguments = command
    path = find_executable(package, executable)
    environment = {key: value for key, value in os.environ.items() if key != "ROS_DOMAIN_ID"}
    ended = subprocess.run([str(path), *arguments], capture_output=True, text=True, check=False, env=environment)
    if ended.returncode != 0:
        raise InputError(f"{executable} ended with status {ended.returncode}: {ended.stderr.strip()[-500:]}")
