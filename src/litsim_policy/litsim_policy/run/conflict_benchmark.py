"""How long conflict detection takes in dense traffic, with a given number of agents."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass

from litsim_policy.conflict.detection import ConflictConfig, ConflictDetector
from litsim_predictor.benchmark import columns_of_traffic
from litsim_predictor.forecast import Forecast
from litsim_predictor.kinematic import KinematicPredictor
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, Controller
from litsim_sim.scenario.log import Log

HORIZON = 5.0  # [s], 50 steps
ROI = 30.0  # [m]
WARM = 10  # steps of motion before the clock starts, so that the predictor has a history
EVERY = 10  # one agent in this many is off its log


@dataclass(frozen=True)
class Timing:
    """What detection took with one number of agents.

    Attributes:
        agents: on the road.
        off_log: of them, the ego included.
        pairs: of an agent on its log and one off it, within the region of interest.
        conflicts: found.
        wall, cpu: of each repetition [ms]; on a busy machine, the latter tells what it would take alone.
    """

    agents: int
    off_log: int
    pairs: int
    conflicts: int
    wall: tuple[float, ...]
    cpu: tuple[float, ...]


def measure_detection(agents: int, repeats: int) -> Timing:
    """Time `repeats` whole detections of a step: both futures over 50 steps, and every pair of them.

    Columns of traffic 10 m apart in five lanes drive at 8 m/s in the log; every tenth agent is off its log and has
    braked to 4 m/s, so that its follower is in conflict with it and those beside it are not.
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
        conflicts = _detect(detector, table, forecast, off)
        marks.append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
    wall, cpu = (tuple(1e3 * value for value in column) for column in zip(*marks, strict=True))
    pairs = len(detector.near(table, ~off, off))
    return Timing(agents, int(off.sum()), pairs, conflicts, wall, cpu)


def detection_rows(timing: Timing) -> Iterator[str]:
    """The cells of the row of `timing` in the printed table."""
    yield from map(str, (timing.agents, timing.off_log, timing.pairs, timing.conflicts))
    for values in (timing.wall, timing.cpu):
        yield f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def _detect(detector: ConflictDetector, table: AgentTable, forecast: Forecast, off: BoolArray) -> int:
    logged, expected = detector.logged_future(table), detector.forecast_future(table, forecast)
    return len(detector.detect(table, ~off, off, logged, expected))


def _slowed(table: AgentTable, off: BoolArray) -> AgentTable:
    """`table` with the agents of the mask off their logs, at half their speed."""
    table.speed[off] *= 0.5
    table.controller[off] = Controller.POLICY
    return table
