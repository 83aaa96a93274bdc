"""Makes the paper's networks anew, its predictor and policy C, from the packaged configurations, with several seeds.

Each training is a process with a folder of its own, in which it can be interrupted and resumed; finished ones are kept.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from litsim_research.paper.tables import write_csv
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import make_folder, write_text
from litsim_sim.io.yaml_input import load_yaml, read_text

PREDICTOR, POLICY = "predictor", "policy"
SUMMARY = "trainings"
CONFIG, TIME, LOG = "config.yaml", "seconds.json", "log.txt"
PACKAGED = {PREDICTOR: "configs/paper.yaml", POLICY: "configs/policies/critic.yaml"}
LENGTH = {PREDICTOR: "epochs", POLICY: "iterations"}
HISTORY = {PREDICTOR: "training.json", POLICY: "history.json"}
CHECKPOINT = "checkpoint.pt"
WEIGHTS = {PREDICTOR: "weights.safetensors", POLICY: "best.safetensors"}
DRIVES = {PREDICTOR: "predictor.model", POLICY: "policy.weights"}
"""Parameters of `--policy paper` that name the weights."""
QUICK: dict[str, dict[str, Any]] = {
    PREDICTOR: {"data": [{"kind": "recording", "files": ["us101_like.parquet"], "share": 0.02}], "epochs": 1},
    POLICY: {
        "data": {"generated": [{"net": "us101_like", "segments": 3, "seed": 4000}]},
        "iterations": 1,
        "transitions": 500,
        "validation_episodes": 4,
        "warm_start": {"epochs": 1},
        "environment": {"steps_max": 60, "sampled": 8},
    },
}
"""What a trial has in place of the fields of the packaged configurations."""
PROGRAM = "from litsim_research.cli.training import main; main()"
POLL_S = 0.2


class TrainingRow(NamedTuple):
    """A training in the summary: what it makes, its seed, how far it is, its time, and its best validation.

    Attributes:
        what: predictor, or policy.
        seed: of everything random.
        done, of: epochs or iterations.
        agent_steps: driven by a policy in training; 0 for predictors.
        minutes: of all its parts together.
        validation: likelihood [nats] of the best epoch, lower is better; penalty of an agent-step of the best
            iteration, higher is better.
    """

    what: str
    seed: int
    done: int
    of: int
    agent_steps: int
    minutes: float
    validation: float | None


@dataclass(frozen=True)
class Job:
    """One training.

    Attributes:
        what: PREDICTOR or POLICY.
        seed: of everything random.
        folder: of its results.
        quick: whether it is a short trial.
    """

    what: str
    seed: int
    folder: Path
    quick: bool

    @cached_property
    def config(self) -> dict[str, Any]:
        """The configuration, with the seed."""
        packaged = Path(str(resources.files("litsim_research"))) / PACKAGED[self.what]
        values: dict[str, Any] = load_yaml(read_text(packaged), str(packaged))
        return values | (QUICK[self.what] if self.quick else {}) | {"seed": self.seed}

    @property
    def length(self) -> int:
        """Epochs or iterations of the whole training."""
        return int(self.config[LENGTH[self.what]])

    @property
    def history(self) -> list[dict[str, float]]:
        """What is written of the training so far."""
        file = self.folder / HISTORY[self.what]
        if not file.is_file():
            return []
        written = json.loads(file.read_text(encoding="utf-8"))
        return list(written["epochs"] if self.what == PREDICTOR else written)

    @property
    def row(self) -> TrainingRow:
        """Where the training stands."""
        history = self.history
        if self.what == PREDICTOR:
            best = min((entry["val_nll"] for entry in history), default=None)
        else:
            best = max((entry["validation_score"] for entry in history if "validation_score" in entry), default=None)
        steps = int(sum(entry.get("transitions", 0.0) for entry in history))
        return TrainingRow(self.what, self.seed, len(history), self.length, steps, round(self.seconds / 60.0, 1), best)

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to train."""
        return len(self.history) >= self.length and (self.folder / WEIGHTS[self.what]).is_file()

    @property
    def seconds(self) -> float:
        """Time that the training has taken so far [s]."""
        file = self.folder / TIME
        return float(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else 0.0

    def begin(self) -> subprocess.Popen[bytes]:
        """Start or resume the training, in a session of its own: signals of the terminal do not reach it."""
        make_folder(self.folder)
        text = json.dumps(self.config, indent=1) + "\n"  # JSON is YAML, too
        write_text(self.folder / CONFIG, text)
        resume = ["--resume"] * (self.folder / CHECKPOINT).is_file()
        own = ["--workers", "1"] if self.what == PREDICTOR else ["--processes", "1"]
        options = ["--config", str(self.folder / CONFIG), "--out", str(self.folder), "--threads", "1", *own, *resume]
        command = [sys.executable, "-c", PROGRAM, self.what, *options]
        with (self.folder / LOG).open("ab") as log:
            return subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL, start_new_session=True)

    def add_time(self, seconds: float) -> None:
        """Add to the time that the training has taken."""
        write_text(self.folder / TIME, json.dumps(self.seconds + seconds))


def jobs(out: Path, seeds: Sequence[int], *, quick: bool) -> list[Job]:
    """Returns the trainings of all `seeds` in folders below `out`; the longer ones first."""
    return [
        Job(what, seed, out / f"{what}_{seed}", quick) for what in (POLICY, PREDICTOR) for seed in dict.fromkeys(seeds)
    ]


def train(wanted: Sequence[Job], out: Path, processes: int) -> None:
    """Carry out or resume the trainings that are not finished, several at a time, and write the summary to `out`.

    Raises:
        InputError: a training fails; its last line says why, and the file of its log is named.
        KeyboardInterrupt: of the user; every training has then ended in order, and can be resumed.
    """
    left = [job for job in wanted if not job.is_done]
    for job in wanted:
        row = job.row
        if row.done:
            print(
                f"{job.what}, seed {job.seed}: {row.done} of {row.of} {LENGTH[job.what]} are done ({row.minutes} min)"
            )
    try:
        with tqdm(total=len(wanted), initial=len(wanted) - len(left), unit="training", dynamic_ncols=True) as bar:
            for job in _carried_out(left, processes):
                bar.write(f"{job.what}, seed {job.seed}: done, {job.row.minutes} min; {job.folder / WEIGHTS[job.what]}")
                bar.update()
    finally:
        write_csv(out / f"{SUMMARY}.csv", [job.row for job in wanted])


def _carried_out(left: Sequence[Job], processes: int) -> Iterator[Job]:
    """Yields the trainings as they end."""
    waiting, running = list(left), dict[Job, tuple[subprocess.Popen[bytes], float]]()
    try:
        while waiting or running:
            while waiting and len(running) < processes:
                job = waiting.pop(0)
                running[job] = job.begin(), time.monotonic()
            time.sleep(POLL_S)
            for job, (process, _) in list(running.items()):
                if process.poll() is not None:
                    _end(job, *running.pop(job))
                    if process.returncode:
                        raise InputError(f"{job.folder / LOG}: the training failed: {_last_line(job.folder / LOG)}")
                    yield job
    finally:
        for process, _ in running.values():
            process.send_signal(signal.SIGINT)
        for job, (process, begun) in running.items():
            _end(job, process, begun)


def _end(job: Job, process: subprocess.Popen[bytes], begun: float) -> None:
    """Wait for a training, and add its time."""
    process.wait()
    job.add_time(time.monotonic() - begun)


def _last_line(log: Path) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1] if lines else "it says nothing"


def summary(wanted: Sequence[Job]) -> list[str]:
    """Returns lines with a table of the trainings, and how `--policy paper` drives with the best of them."""
    lines = ["| | seed | done | agent-steps, M | minutes | validation |", "|---|---:|---:|---:|---:|---:|"]
    best: dict[str, tuple[float, Job]] = {}
    for job in wanted:
        row = job.row
        value = "-" if row.validation is None else f"{row.validation:.4f}"
        steps = "-" if job.what == PREDICTOR else f"{row.agent_steps / 1e6:.2f}"
        done = f"{row.done} of {row.of} {LENGTH[job.what]}"
        lines.append(f"| {job.what} | {job.seed} | {done} | {steps} | {row.minutes:g} | {value} |")
        if row.validation is not None and (score := _score(row)) > best.get(job.what, (float("-inf"), job))[0]:
            best[job.what] = score, job
    chosen = [f"{DRIVES[what]}={(job.folder / WEIGHTS[what]).resolve()}" for what, (_, job) in best.items()]
    return [*lines, "", "drive with the best: --policy paper --set " + " ".join(chosen)] if chosen else lines


def _score(row: TrainingRow) -> float:
    """Returns the validation of a training, higher for a better one."""
    assert row.validation is not None
    return -row.validation if row.what == PREDICTOR else row.validation
