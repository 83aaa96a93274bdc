"""Episodes driven in several processes, which hold environments of their own: the same episodes, sooner."""

from __future__ import annotations

import multiprocessing
import signal
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Literal

import numpy as np
import torch

from litsim_policy.learning.config import TrainConfig
from litsim_policy.learning.data import TrainingData
from litsim_policy.learning.environment import PolicyEnvironment
from litsim_policy.learning.network import GaussianPolicy
from litsim_policy.learning.rollout import Driving, Episode, HereDriving, drive

Part = Literal["train", "validation"]
PARTS: tuple[Part, ...] = ("train", "validation")
Weights = dict[str, np.ndarray]


@contextmanager
def rollouts(data: TrainingData, config: TrainConfig, processes: int) -> Iterator[tuple[Driving, Driving]]:
    """What drives the episodes of training and of validation, in as many processes; 1 is this one."""
    if processes == 1:
        yield HereDriving(_environment(data, config, "train")), HereDriving(_environment(data, config, "validation"))
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, _begin, (data, config)) as pool:
        for _ in range(processes):
            pool.submit(_ready)  # they load what they need while the experts are looked at
        try:
            yield PoolDriving(pool, "train", processes), PoolDriving(pool, "validation", processes)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


class PoolDriving:
    """Drives in the processes of a pool."""

    def __init__(self, pool: ProcessPoolExecutor, part: Part, processes: int) -> None:
        self._pool, self._part, self._processes = pool, part, processes

    def episodes(
        self, policy: GaussianPolicy, seeds: Iterable[int], enough: float, *, draws: bool
    ) -> Iterator[Episode]:
        """See :class:`litsim_policy.learning.rollout.Driving`."""
        weights = {name: values.detach().numpy().copy() for name, values in policy.state_dict().items()}
        waiting: deque[Future[Episode]] = deque()
        coming = iter(seeds)
        driven = done = 0.0
        more = True
        while waiting or more:
            while more and len(waiting) < self._processes and _are_too_few(driven, done, len(waiting), enough):
                seed = next(coming, None)
                more = seed is not None
                if seed is not None:
                    waiting.append(self._pool.submit(_drive, self._part, weights, seed, draws))
            if not waiting:
                return
            episode = waiting.popleft().result()
            driven, done = driven + episode.sums.get("transitions", 0.0), done + 1.0
            yield episode


def _are_too_few(driven: float, done: float, waiting: int, enough: float) -> bool:
    """Whether another episode is likely to be asked for, as those so far had `driven` agent-steps.

    A guess, of what to begin while others are still being driven: the first of a line is always asked for.
    """
    return not waiting or driven + waiting * driven / max(done, 1.0) < enough


_environments: dict[Part, PolicyEnvironment] = {}
_policies: list[GaussianPolicy] = []


def _begin(data: TrainingData, config: TrainConfig) -> None:
    """Make a process of the pool ready."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; who has begun this one ends it
    torch.set_num_threads(1)
    _environments.update({part: _environment(data, config, part) for part in PARTS})
    _policies.append(GaussianPolicy(config.observation))


def _ready() -> None:
    """Nothing: a process that is asked for it begins."""


def _drive(part: Part, weights: Weights, seed: int, draws: bool) -> Episode:
    (policy,) = _policies
    policy.load_state_dict({name: torch.from_numpy(values) for name, values in weights.items()})
    return drive(_environments[part], policy, seed, draws=draws)


def _environment(data: TrainingData, config: TrainConfig, part: Part) -> PolicyEnvironment:
    return PolicyEnvironment(getattr(data, part), config.environment, config.observation, config.penalty)
