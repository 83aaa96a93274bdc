"""Egos that leave their log on their logged path: what forecasts of conflicts are judged by. No torch is needed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from litsim_predictor.inference.contract import SECONDS
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

DriveKind = Literal["keeps_speed", "brakes"]
DRIVE_KINDS: tuple[DriveKind, ...] = get_args(DriveKind)

DECELERATION = 2.0  # [m/s2]
BRAKING_S = 2.5
BRAKES = 2  # drives of each ego that brake, each at a time of its own; in one more it keeps its speed


@dataclass(frozen=True)
class Drive:
    """What an ego does that is off its log from some step on; arrays (steps,) from step 0, frame map.

    Attributes:
        ego: id.
        kind: "keeps_speed" or "brakes".
        x, y: box centre [m].
        yaw: [rad].
        speed: [m/s].
    """

    ego: int
    kind: DriveKind
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray


def drives(scenario: Scenario, ego: int, rng: np.random.Generator) -> list[Drive]:
    """The drives of `ego`: keeps its speed from the end of the history on; brakes at times drawn by `rng`.

    Each ends with the ego's log, or where its logged path ends.

    Raises:
        InputError: the scenario has no such vehicle.
    """
    log, start = scenario.log, scenario.history_steps
    row = log.row(ego)
    if row < 0:
        raise InputError(f"{scenario.name}: no vehicle {ego}")
    last = int(log.last_step[row])
    latest = max(last - round((BRAKING_S + SECONDS[0]) / STEP_S), start)
    brakes = np.sort(rng.integers(start, latest + 1, BRAKES))
    keeps = np.zeros(last)
    plans: list[tuple[DriveKind, int, FloatArray]] = [("keeps_speed", start, keeps)]
    for brake in brakes:
        acceleration = keeps.copy()
        acceleration[brake : brake + round(BRAKING_S / STEP_S)] = -DECELERATION
        plans.append(("brakes", int(brake), acceleration))
    return [along_path(log, row, kind, begin, acceleration) for kind, begin, acceleration in plans]


def along_path(log: Log, row: int, kind: DriveKind, start: int, acceleration: FloatArray) -> Drive:
    """The agent of `row` on its logged path, by its log up to step `start`, then with `acceleration` (steps,) [m/s2].

    The agent is there at step 0. It does not reverse. The drive ends with the log, or where the path ends.
    """
    last = int(log.last_step[row])
    x, y, yaw = log.x[row, : last + 1], log.y[row, : last + 1], np.unwrap(log.yaw[row, : last + 1])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    gone, speed = way.copy(), log.speed[row, : last + 1].copy()
    for step in range(start, last):
        speed[step + 1] = max(speed[step] + acceleration[step] * STEP_S, 0.0)
        gone[step + 1] = gone[step] + 0.5 * (speed[step] + speed[step + 1]) * STEP_S
    inside = gone <= way[-1] + 1e-9
    count = len(gone) if inside.all() else int(np.argmin(inside))
    gone = gone[:count]
    advances = np.append(np.diff(way) > 0.0, [True])  # where it stood, the path has one point: the last
    way = way[advances]
    pose = [np.interp(gone, way, values[advances]) for values in (x, y, yaw)]
    return Drive(int(log.ids[row]), kind, pose[0], pose[1], pose[2], speed[:count])
