"""The forecasts of a bag, thinned for pictures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.core.topic_names import FORECASTS
from litsim_sim.record.bag import BagReader
from litsim_sim.record.decoding import UNDECODABLE, decoded
from litsim_sim.record.run import Run
from litsim_sim.scenario.run_info import IN_PROCESS

POINTS_MAX = 13  # most points of one forecast: 5 s every 0.4 s


@dataclass(frozen=True)
class Forecasts:
    """Forecasts of single agents; m of them with T points each, ordered by agent and step.

    Attributes:
        agent: (m,) ids.
        step: (m,) steps at which they were made.
        time: (T,) times of the points after that step [s].
        mean: (m, T, 2) box centres in frame map [m].
        spread: (m, T, 3) sigma_x, sigma_y [m] and correlation.
    """

    agent: IntArray
    step: IntArray
    time: FloatArray
    mean: FloatArray
    spread: FloatArray

    def every(self, steps: int) -> Forecasts:
        """Returns the forecasts made at those steps that are multiples of `steps`."""
        chosen = self.step % steps == 0
        return Forecasts(self.agent[chosen], self.step[chosen], self.time, self.mean[chosen], self.spread[chosen])


def read_forecasts(run: Run) -> Forecasts:
    """Returns forecasts recorded in the bag of `run`; none if the run had no predictor.

    Raises:
        InputError: the topic cannot be read as joint forecasts of one length.
    """
    parts: list[tuple[IntArray, IntArray, FloatArray, FloatArray]] = []
    time = np.empty(0)
    try:
        for message in _messages(run):
            n, points = len(message.id), 0 if not len(message.id) else len(message.mean) // (2 * len(message.id))
            if not points:
                continue
            stride = -(-points // POINTS_MAX)
            picked = np.arange((points - 1) % stride, points, stride)  # evenly spaced, with the last
            time = (picked + 1.0) * message.dt
            mean = np.asarray(message.mean, np.float64).reshape(n, points, 2)[:, picked]
            spread = np.asarray(message.covariance, np.float64).reshape(n, points, 3)[:, picked]
            usable = (
                np.asarray(message.valid, np.bool_) & np.isfinite(mean).all((1, 2)) & np.isfinite(spread).all((1, 2))
            )
            ids = np.asarray(message.id, np.int64)[usable]
            parts.append((ids, np.full(len(ids), int(message.step), np.int64), mean[usable], spread[usable]))
        if not parts:
            return Forecasts(
                np.empty(0, np.int64), np.empty(0, np.int64), time, np.empty((0, 0, 2)), np.empty((0, 0, 3))
            )
        agent, step, mean, spread = (np.concatenate(column) for column in zip(*parts, strict=True))
    except UNDECODABLE as error:
        raise InputError(f"{run.path}: topic {FORECASTS}: not joint forecasts of this version: {error}") from error
    order = np.lexsort((step, agent))
    return Forecasts(agent[order], step[order], time, mean[order], spread[order])


def _messages(run: Run) -> Iterator[Any]:
    """Yields decoded messages of the run itself, the first of each step; none of a run that was not recorded."""
    if run.info.mode == IN_PROCESS:
        return
    reader, steps = BagReader(run.path), set()
    if FORECASTS not in reader.topics:
        return
    for recorded in reader.messages({FORECASTS}):
        message = decoded(reader.topics[FORECASTS], recorded.data)
        if message.run_id == run.info.run_id and message.step not in steps:
            steps.add(message.step)
            yield message
