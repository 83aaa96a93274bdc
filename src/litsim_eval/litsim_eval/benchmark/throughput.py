"""Benchmark of throughput: scenario-seconds of `evaluate` and agent-steps of `train` per second, also of two checkouts.

Both checkouts are timed alternately, as whole processes; compare the ratios within a pair.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from litsim_eval.benchmark.steps import Sample, execute, spread
from litsim_eval.campaign.results import RESULTS_FILE
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S

EVALUATE = "evaluate, scenario-seconds a second"
TRAINING_MODULE = "litsim_research.policies.train"
TRAIN = "train, agent-steps a second"
ITERATIONS = "train, its iterations alone, agent-steps a second"
CPU = " of the processor"
FIGURES = (EVALUATE, EVALUATE + CPU, TRAIN, TRAIN + CPU, ITERATIONS)
HERE, BESIDE, RATIO = "this checkout", "the other", "ratio"

POLICIES = ("replay", "yield", "litsim")
TRAINING = {
    "seed": 0,
    "iterations": 10,
    "validate_every": 100,
    "validation_episodes": 8,
    "warm_start": {"epochs": 5},
    "data": {
        "generated": [
            {"net": "us101_like", "segments": 8, "seed": 4000},
            {"net": "urban_like", "segments": 4, "seed": 4100},
        ]
    },
}
"""Configuration of the timed training: a sixth of that of `policy_c_critic.yaml`, without its real windows."""

TIMED = """
import resource, subprocess, sys, time
begin = time.perf_counter()
ended = subprocess.run(sys.argv[2:], stdout=subprocess.DEVNULL).returncode
wall, used = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
print(wall, used.ru_utime + used.ru_stime)
sys.exit(0 if str(ended) in sys.argv[1].split() else ended)
"""
"""Program that runs a command and prints its wall time and its CPU time [s].

Its first argument lists the exit statuses of success. It runs within the checkout's environment, so that setting this
up does not count.
"""
OF_A_CHECKOUT = ("PYTHONPATH", "AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH", "CMAKE_PREFIX_PATH", "LD_LIBRARY_PATH")
"""Environment variables that point to a checkout."""


@dataclass(frozen=True)
class Side:
    """A checkout that is timed.

    Attributes:
        python: command that runs Python in its environment.
        environment: environment variables to run it with.
    """

    python: tuple[str, ...]
    environment: Mapping[str, str]

    @classmethod
    def here(cls) -> Side:
        """Returns the checkout of this process."""
        return cls((sys.executable,), os.environ)

    @classmethod
    def beside(cls, checkout: Path) -> Side:
        """Returns another checkout of this layout, which must be built.

        Raises:
            InputError: it is not a checkout of LitSim.
        """
        if not (checkout / "litsim").is_file():
            raise InputError(f"{checkout}: not a checkout of LitSim, expected a folder with the script litsim")
        environment = {key: value for key, value in os.environ.items() if key not in OF_A_CHECKOUT}
        return cls((str(checkout.absolute() / "litsim"), "exec", "python"), environment)

    def rates(self, module: str, *arguments: str, answers_no: bool = False) -> Callable[[str, float], Sample]:
        """Runs and times a program of the checkout; with `answers_no`, exit status 1 is a success.

        Returns a function from the name of a figure and the amount of work done to the rates per second of both clocks.

        Raises:
            InputError: the program fails.
        """
        run, *options = self.python
        words = ("0 1" if answers_no else "0", "python" if options else run, "-m", module, *arguments)
        output = execute(Path(run), *options, "-c", TIMED, *words, environment=self.environment)
        wall, processor = (float(seconds) for seconds in output.strip().splitlines()[-1].split())
        return lambda figure, amount: {figure: amount / wall, figure + CPU: amount / processor}


def time_evaluation(side: Side, scenarios: Sequence[str], ego_id: str | None, processes: int, out: Path) -> Sample:
    """Times `evaluate` with :data:`POLICIES` on the egos of `scenarios`, in process.

    Raises:
        InputError: it fails.
    """
    options = ["--scenario", *scenarios, "--ego", "idm", "--policy", *POLICIES, "--out", str(out)]
    options += [] if ego_id is None else ["--ego-id", ego_id]
    shutil.rmtree(out, ignore_errors=True)  # an existing campaign there would be resumed
    rates = side.rates("litsim_eval.cli.evaluate", *options, "--processes", str(processes), answers_no=True)
    steps = [run["metrics"]["steps"] for run in json.loads((out / RESULTS_FILE).read_text())["runs"]]
    return rates(EVALUATE, STEP_S * sum(steps))


def generated_data(side: Side, out: Path) -> Path:
    """Lets `train` generate its segments, and returns their folder; each checkout reads its own.

    Raises:
        InputError: it fails.
    """
    _train(side, out)
    return out / "data"


def _train(side: Side, out: Path) -> Callable[[str, float], Sample]:
    """Runs and times `train`; see :meth:`Side.rates`."""
    out.mkdir(parents=True, exist_ok=True)
    config = out / "config.yaml"
    config.write_text(yaml.safe_dump(TRAINING))
    return side.rates(TRAINING_MODULE, "--config", str(config), "--out", str(out))


def time_training(side: Side, data: Path, out: Path) -> Sample:
    """Times `train` on the generated segments in `data`, including its start-up and its warm start.

    Raises:
        InputError: it fails.
    """
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(data, out / "data")
    rates = _train(side, out)
    history = json.loads((out / "history.json").read_text())
    steps = sum(entry["transitions"] for entry in history)
    return rates(TRAIN, steps) | {ITERATIONS: steps / sum(entry["seconds"] for entry in history)}


def measure_throughput(
    folder: Path,
    beside: Path | None,
    scenarios: Sequence[str],
    ego_id: str | None,
    processes: int,
    pairs: int,
    done: Callable[[], object],
) -> dict[str, list[Sample]]:
    """Times this checkout and the one `beside` alternately.

    Args:
        folder: for the output of the programs.
        beside: the other checkout; None to time this one alone.
        scenarios, ego_id: to evaluate, as the options of `evaluate`.
        processes: of an evaluation.
        pairs: number of measurements of each side.
        done: called after each pair.

    Returns:
        samples by side, and ratios if there are two.

    Raises:
        InputError: a program fails.
    """
    sides = {HERE: Side.here()} | ({} if beside is None else {BESIDE: Side.beside(beside)})
    data = {name: generated_data(side, folder / f"generated by {name}") for name, side in sides.items()}
    samples: dict[str, list[Sample]] = {name: [] for name in sides}
    for pair in range(pairs):
        for name, side in list(sides.items())[:: 1 if pair % 2 else -1]:  # neither side always comes second
            sample = time_evaluation(side, scenarios, ego_id, processes, folder / "evaluation")
            samples[name].append(sample | time_training(side, data[name], folder / "training"))
        done()
    if beside is not None:
        both = list(zip(samples[HERE], samples[BESIDE], strict=True))
        samples[RATIO] = [{figure: here[figure] / there[figure] for figure in FIGURES} for here, there in both]
    return samples


def throughput_rows(found: Mapping[str, Sequence[Sample]]) -> Iterator[list[str]]:
    """Yields rows of the table: name, and median (minimum to maximum) for each side and for the ratio."""
    for figure in FIGURES:
        yield [figure, *(spread(samples, figure) for samples in found.values())]
