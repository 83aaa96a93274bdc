"""Benchmark of conflict detection in dense traffic, by number of agents."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass

from litsim_eval.benchmark.forecasts import columns_of_traffic
from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.detector import ConflictDetector
from litsim_policy.conflict.futures import Futures
from litsim_predictor.kinematic import KinematicPredictor
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, Controller
from litsim_sim.scenario.log import Log

HORIZON = 5.0  # [s], 50 steps
ROI = 30.0  # [m]
WARM = 10  # steps before the measurement, as history for the predictor
EVERY = 10  # one in so many agents is off its log


@dataclass(frozen=True)
class Timing:
    """Times of detection with one number of agents.

    Attributes:
        agents: number on the road.
        off_log: number off their logs, the ego included.
        pairs: number of pairs of an agent on its log and one off it, within the region of interest.
        conflicts: number found.
        wall, cpu: wall and CPU time of each repetition [ms].
    """

    agents: int
    off_log: int
    pairs: int
    conflicts: int
    wall: tuple[float, ...]
    cpu: tuple[float, ...]


def measure_detection(agents: int, repeats: int) -> Timing:
    """Time `repeats` detections of a step: both futures over 50 steps, and all pairs of them.

    In the log, columns of traffic in five lanes drive 10 m apart at 8 m/s. Every tenth agent is off its log and has
    braked to 4 m/s, so that it is in conflict with its follower, but not with agents beside it.
    """
    recording = columns_of_traffic(agents, WARM * STEP_S + HORIZON)
    log = Log.from_recording(recording, 0, WARM + round(HORIZON / STEP_S) + 1)
    detector = ConflictDetector(log, ROI, ConflictConfig(horizon=HORIZON))
    off = log.ids % EVERY == 0
    predictor = KinematicPredictor(int(log.ids[off][0]), ROI)
    for step in range(WARM + 1):
        table = _slowed(log.table(step), off)
        forecast = predictor.forecast(table)
    marks = []
    for _ in range(repeats):
        begin = time.perf_counter(), time.process_time()
        futures = Futures(log, detector.config, table, forecast)
        conflicts = len(detector.conflicts(futures, ~off, off))
        marks.append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
    wall, cpu = (tuple(1e3 * value for value in column) for column in zip(*marks, strict=True))
    pairs, _ = detector.pair_probabilities(futures, ~off, off, 1.0)
    return Timing(agents, int(off.sum()), len(pairs), conflicts, wall, cpu)


def detection_rows(timing: Timing) -> Iterator[str]:
    """Cells of the table's row for `timing`."""
    yield from map(str, (timing.agents, timing.off_log, timing.pairs, timing.conflicts))
    for values in (timing.wall, timing.cpu):
        yield f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def _slowed(table: AgentTable, off: BoolArray) -> AgentTable:
    """`table`, changed in place: agents in the mask `off` (n,) are off their logs, at half their speed."""
    table.speed[off] *= 0.5
    table.controller[off] = Controller.POLICY
    return table
