"""A jam: what a step costs by the number of agents under control, in this process and over the graph.

    ./litsim exec python benchmarks/jam/jam.py [--agents 1000] [--seconds 40] [--repeats 3] [--graph]

Five columns of vehicles drive behind an ego that brakes to a stand; with boxes that count as 25 m longer, conflicts are
seen early, and whole columns are taken over in one step. Prints a table in Markdown. In process, times are those of the
processor [ms], so that other programs on the machine matter less: medians of each stage and of the whole step, and the
longest step. With `--graph`, the same run is made over DDS with a full record; its times are of the wall clock.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from statistics import median

import yaml

from litsim_eval.benchmark.steps import FREE_ROAD, HISTORY_S, columns_of_traffic, execute, straight_road
from litsim_sim.core.parameters import Parameters
from litsim_sim.core.stages import BRIDGE
from litsim_sim.launch.nodes import find_executable
from litsim_sim.record.run import read_run
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation

EGO, POLICY = "perturbed", "litsim"
PARAMETERS: Parameters = {"conflict": {"margin": 25.0}, "ego": {"kind": "brake", "deceleration": 6.0, "duration": 20.0}}
STAGES = ("bridge", "predictor", "conflict", "policy")
WHOLE, GRAPH = "whole step", "over the graph"
BINS = (1, 25, 75, 125, 175, 225, 275, 325, 375, 1000)

Steps = list[tuple[int, dict[str, float]]]
"""Number of agents under control and times [ms] of each step after the history."""


def write_jam(folder: Path, agents: int, seconds: float) -> Path:
    """Writes the scenario: an ego in the foremost quarter of five columns on a straight road."""
    recording = columns_of_traffic(agents, seconds)
    recording.write(folder / "jam.parquet")
    net = straight_road(float(recording.table["x"].max()) + FREE_ROAD)
    (folder / "jam.net.xml").write_text(net, encoding="utf-8")
    values = {"name": "jam", "recording": "jam.parquet", "net": str(folder / "jam.net.xml"), "roi_m": 60.0}
    values |= {"ego": 3 * agents // 4, "history_s": HISTORY_S, "simulation_s": seconds - HISTORY_S}
    (folder / "jam.yaml").write_text(yaml.safe_dump(values))
    return folder / "jam.yaml"


def in_process(file: Path) -> Steps:
    """Returns the steps of a run in this process; times of the processor."""
    scenario = Scenario.load(file)
    steps, begin = Steps(), 0.0
    for result in Simulation.of(RunPlan(scenario, EGO, POLICY, PARAMETERS), clock=time.process_time).steps():
        whole, begin = time.process_time() - begin, time.process_time()
        if result.table.step > scenario.history_steps and result.takeovers is not None:
            times = {stage: 1e3 * result.stage_s[stage] for stage in STAGES}
            steps.append((len(result.takeovers.takeovers), times | {WHOLE: 1e3 * whole}))
    return steps


def over_graph(file: Path, bag: Path) -> Steps:
    """Returns the steps of a run over DDS, from the recorded marks of the bridge."""
    settings = (f"{stage}.{name}={value}" for stage, values in PARAMETERS.items() for name, value in values.items())
    words = ("--quiet", "--overwrite", "--out", str(bag), "--scenario", str(file), "--ego", EGO, "--policy", POLICY)
    execute(find_executable("litsim_sim", "launch"), *words, "--set", *settings)
    run = read_run(bag)
    begins = {step: at["begin"] for step, at in run.marks[BRIDGE].items() if step > run.info.history_steps}
    return [
        (len(run.takeovers[step]), {GRAPH: 1e3 * (begins[step + 1] - begin)})
        for step, begin in begins.items()
        if step + 1 in begins
    ]


def rows_of(steps: Iterable[tuple[int, dict[str, float]]]) -> Iterator[list[str]]:
    """Yields rows of the table: agents under control, steps, medians of all times, and the greatest of the last."""
    steps = list(steps)
    for least, end in pairwise(BINS):
        times = [values for count, values in steps if least <= count < end]
        if times:
            columns = [[values[name] for values in times] for name in times[0]]
            medians = [f"{median(column):.1f}" for column in columns]
            yield [f"{least} to {end - 1}", str(len(times)), *medians, f"{max(columns[-1]):.1f}"]


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--graph", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        file = write_jam(Path(name), arguments.agents, arguments.seconds)
        sides: dict[tuple[str, ...], Callable[[], Steps]] = {(*STAGES, WHOLE): lambda: in_process(file)}
        if arguments.graph:
            sides[GRAPH,] = lambda: over_graph(file, Path(name) / "bag")
        for names, measure in sides.items():
            steps = [step for _ in range(arguments.repeats) for step in measure()]
            head = ["under control", "steps", *names, "longest"]
            for row in (head, ["---:"] * len(head), *rows_of(steps)):
                print(f"| {' | '.join(row)} |")
            print()


if __name__ == "__main__":
    main()
