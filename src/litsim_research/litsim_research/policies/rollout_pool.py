"""Episodes driven in several processes, with the same results as in one."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from litsim_research.policies.config import TrainConfig
from litsim_research.policies.data import TrainingData
from litsim_research.policies.episodes import Course
from litsim_research.policies.network import GaussianPolicy
from litsim_research.policies.rollout import BATCH_MAX, Driving, Episode, by_kind, drive, driving_here

Part = Literal["train", "validation"]
PARTS: tuple[Part, ...] = ("train", "validation")


@contextmanager
def rollouts(data: TrainingData, config: TrainConfig, processes: int) -> Iterator[tuple[Driving, Driving]]:
    """Yield what drives the episodes of training, with drawn actions, and those of validation, with the means.

    They are driven in `processes` processes; 1 is this one.
    """
    train, validation = (_course(data, config, part) for part in PARTS)
    if processes == 1:
        yield driving_here(train, draws=True), driving_here(validation, draws=False)
        return
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="litsim_") as folder:
        given = Path(folder) / "given"  # a file: megabytes as arguments would block this process until each has started
        given.write_bytes(pickle.dumps((data, config)))
        with ProcessPoolExecutor(processes, context, _begin, (given,)) as pool:
            for _ in range(processes):
                pool.submit(_ready)  # processes start and import while this one computes the expert pairs
            try:
                yield _in_pool(pool, "train", train, processes), _in_pool(pool, "validation", validation, processes)
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


def _in_pool(pool: ProcessPoolExecutor, part: Part, course: Course, processes: int) -> Driving:
    """Returns what drives episodes of `course` in the processes of `pool`."""

    def episodes(policy: GaussianPolicy, seeds: Sequence[int]) -> Iterator[Episode]:
        weights = {name: values.detach().numpy().copy() for name, values in policy.state_dict().items()}
        shares = shared_out(by_kind(map(course.scenario_of, seeds)), processes)
        jobs = [pool.submit(_drive, part, weights, [seeds[k] for k in share]) for share in shares]
        driven = dict(zip(chain(*shares), chain(*(job.result() for job in jobs)), strict=True))
        yield from (driven[number] for number in range(len(seeds)))

    return episodes


def shared_out(groups: Iterable[Sequence[int]], processes: int) -> list[Sequence[int]]:
    """Returns `groups` as shares for the pool, largest first; each share goes to the process that is free first.

    A group is cut where it exceeds an equal part of all episodes, or BATCH_MAX episodes.
    """
    every = list(groups)
    most = min(BATCH_MAX, -(-sum(map(len, every)) // processes))
    shares = [group[first : first + most] for group in every for first in range(0, len(group), most)]
    return sorted(shares, key=len, reverse=True)


_courses: dict[Part, Course] = {}
_policies: list[GaussianPolicy] = []


def _begin(given: Path) -> None:
    """Initialise a process of the pool with the data and the configuration in the file `given`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the parent process ends this one
    torch.set_num_threads(1)
    if not given.exists():  # the training is over or interrupted already: this process will not be asked for anything
        return
    data, config = pickle.loads(given.read_bytes())  # noqa: S301 - written by the parent process
    _courses.update({part: _course(data, config, part) for part in PARTS})
    _policies.append(GaussianPolicy(config.observation))


def _ready() -> None:
    """Do nothing; submitting this starts a process of the pool."""


def _drive(part: Part, weights: dict[str, np.ndarray], seeds: list[int]) -> list[Episode]:
    (policy,) = _policies
    policy.load_state_dict({name: torch.from_numpy(values) for name, values in weights.items()})
    return drive(_courses[part], policy, seeds, draws=part == "train")


def _course(data: TrainingData, config: TrainConfig, part: Part) -> Course:
    scenarios, environment = getattr(data, part), config.environment
    if part == "validation" and config.validate_conflicts:
        environment = replace(environment, recorded=0.0, sampled=0)
    return Course(scenarios, environment, config.observation, config.penalty, task=config.task)
