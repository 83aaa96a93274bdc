"""Episodes driven in several processes, which hold environments of their own: the same episodes, sooner."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from heapq import heapreplace
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from litsim_policy.learning.config import TrainConfig
from litsim_policy.learning.data import TrainingData
from litsim_policy.learning.episodes import Course
from litsim_policy.learning.network import GaussianPolicy
from litsim_policy.learning.rollout import TOGETHER, Driving, Episode, HereDriving, by_kind, drive

Part = Literal["train", "validation"]
PARTS: tuple[Part, ...] = ("train", "validation")
STEPS_COST = 2.0  # what a step costs however many episodes take it: so many times of what an episode adds (1.5 to 3)
Weights = dict[str, np.ndarray]


@contextmanager
def rollouts(data: TrainingData, config: TrainConfig, processes: int) -> Iterator[tuple[Driving, Driving]]:
    """What drives the episodes of training and of validation, in as many processes; 1 is this one."""
    if processes == 1:
        yield HereDriving(_course(data, config, "train")), HereDriving(_course(data, config, "validation"))
        return
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="litsim_") as folder:
        given = Path(folder) / "given"  # megabytes: as arguments, each process would keep this one until it has begun
        given.write_bytes(pickle.dumps((data, config)))
        with ProcessPoolExecutor(processes, context, _begin, (given,)) as pool:
            for _ in range(processes):
                pool.submit(_ready)  # they load what they need while the experts are looked at
            try:
                courses = {part: _course(data, config, part) for part in PARTS}
                driving, validation = (PoolDriving(pool, part, courses[part], processes) for part in PARTS)
                yield driving, validation
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


class PoolDriving:
    """Drives in the processes of a pool."""

    def __init__(self, pool: ProcessPoolExecutor, part: Part, course: Course, processes: int) -> None:
        self._pool, self._part, self._course, self._processes = pool, part, course, processes

    def episodes(self, policy: GaussianPolicy, seeds: Sequence[int], *, draws: bool) -> Iterator[Episode]:
        """See :class:`litsim_policy.learning.rollout.Driving`."""
        weights = {name: values.detach().numpy().copy() for name, values in policy.state_dict().items()}
        shares = shared_out(by_kind(self._course, seeds), self._processes)
        jobs = [self._pool.submit(_drive, self._part, weights, [seeds[k] for k in share], draws) for share in shares]

        def driven() -> Iterator[Episode]:
            found = dict(zip(chain(*shares), chain(*(job.result() for job in jobs)), strict=True))
            yield from (found[number] for number in range(len(seeds)))

        return driven()


def shared_out(groups: Iterable[Sequence[int]], processes: int) -> list[Sequence[int]]:
    """`groups` as they are given to processes, the largest first: each share goes to the process that is free first.

    A group is cut where all is then done sooner, by what shares are expected to cost, or where it is more episodes than
    are stepped together.
    """
    shares = sorted(groups, key=len, reverse=True)
    while len(shares[0]) > TOGETHER:
        shares = _cut(shares, len(shares[0]) // 2)
    while True:
        cuts = (_cut(shares, size) for size in range(1, len(shares[0]) // 2 + 1))
        sooner = min(cuts, key=lambda cut: _expected_end(cut, processes), default=shares)
        if _expected_end(sooner, processes) >= _expected_end(shares, processes):
            return shares
        shares = sooner


def _cut(shares: list[Sequence[int]], size: int) -> list[Sequence[int]]:
    """`shares` with the first of them in two, the first `size` episodes and the others; the largest first."""
    largest, *others = shares
    return sorted([largest[:size], largest[size:], *others], key=len, reverse=True)


def _expected_end(shares: list[Sequence[int]], processes: int) -> float:
    """When the last of `processes` is done with `shares`, in the time that an episode takes among others."""
    free_at = [0.0] * processes
    for share in shares:
        heapreplace(free_at, free_at[0] + STEPS_COST + len(share))
    return max(free_at)


_courses: dict[Part, Course] = {}
_policies: list[GaussianPolicy] = []


def _begin(given: Path) -> None:
    """Make a process of the pool ready, by the data and the configuration in the file `given`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; who has begun this one ends it
    torch.set_num_threads(1)
    data, config = pickle.loads(given.read_bytes())  # noqa: S301 - written by the process that begins this one
    _courses.update({part: _course(data, config, part) for part in PARTS})
    _policies.append(GaussianPolicy(config.observation))


def _ready() -> None:
    """Nothing: a process that is asked for it begins."""


def _drive(part: Part, weights: Weights, seeds: list[int], draws: bool) -> list[Episode]:
    (policy,) = _policies
    policy.load_state_dict({name: torch.from_numpy(values) for name, values in weights.items()})
    return drive(_courses[part], policy, seeds, draws=draws)


def _course(data: TrainingData, config: TrainConfig, part: Part) -> Course:
    scenarios = getattr(data, part)
    return Course(scenarios, config.environment, config.observation, config.penalty, task=config.task)
