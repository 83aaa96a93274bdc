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
from litsim_research.policies.rollout import BATCH_MAX, Driving, Episode, HereDriving, by_kind, drive

Part = Literal["train", "validation"]
PARTS: tuple[Part, ...] = ("train", "validation")
Weights = dict[str, np.ndarray]


@contextmanager
def rollouts(data: TrainingData, config: TrainConfig, processes: int) -> Iterator[tuple[Driving, Driving]]:
    """Yield what drives the episodes of training and of validation, in `processes` processes; 1 is this one."""
    if processes == 1:
        yield HereDriving(_course(data, config, "train")), HereDriving(_course(data, config, "validation"))
        return
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="litsim_") as folder:
        given = Path(folder) / "given"  # a file: megabytes as arguments would block this process until each has started
        given.write_bytes(pickle.dumps((data, config)))
        with ProcessPoolExecutor(processes, context, _begin, (given,)) as pool:
            for _ in range(processes):
                pool.submit(_ready)  # processes start and import while this one computes the expert pairs
            try:
                courses = {part: _course(data, config, part) for part in PARTS}
                driving, validation = (PoolDriving(pool, part, courses[part], processes) for part in PARTS)
                yield driving, validation
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


class PoolDriving:
    """Drives episodes in the processes of a pool."""

    def __init__(self, pool: ProcessPoolExecutor, part: Part, course: Course, processes: int) -> None:
        self._pool, self._part, self._course, self._processes = pool, part, course, processes

    def episodes(self, policy: GaussianPolicy, seeds: Sequence[int], *, draws: bool) -> Iterator[Episode]:
        """See :class:`litsim_research.policies.rollout.Driving`."""
        weights = {name: values.detach().numpy().copy() for name, values in policy.state_dict().items()}
        shares = shared_out(by_kind(map(self._course.scenario_of, seeds)), self._processes)
        jobs = [self._pool.submit(_drive, self._part, weights, [seeds[k] for k in share], draws) for share in shares]

        def driven() -> Iterator[Episode]:
            found = dict(zip(chain(*shares), chain(*(job.result() for job in jobs)), strict=True))
            yield from (found[number] for number in range(len(seeds)))

        return driven()


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


def _drive(part: Part, weights: Weights, seeds: list[int], draws: bool) -> list[Episode]:
    (policy,) = _policies
    policy.load_state_dict({name: torch.from_numpy(values) for name, values in weights.items()})
    return drive(_courses[part], policy, seeds, draws=draws)


def _course(data: TrainingData, config: TrainConfig, part: Part) -> Course:
    scenarios, environment = getattr(data, part), config.environment
    if part == "validation" and config.validate_conflicts:
        environment = replace(environment, recorded=0.0, sampled=0)
    return Course(scenarios, environment, config.observation, config.penalty, task=config.task)
