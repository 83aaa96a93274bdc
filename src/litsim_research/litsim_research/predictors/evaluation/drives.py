"""Drives of egos that deviate from their logs on their logged paths, for the evaluation of conflicts; without torch."""

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
BRAKES = 2  # number of drives in which an ego brakes, each at a random time; in a further one it keeps its speed


@dataclass(frozen=True)
class Drive:
    """Motion of an ego that deviates from its log from some step on; arrays (steps,) from step 0, in frame map.

    Attributes:
        ego: id of the ego.
        kind: "keeps_speed" or "brakes".
        x, y: box centre [m].
        yaw: heading [rad].
        speed: speed [m/s].
    """

    ego: int
    kind: DriveKind
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray


def drives(scenario: Scenario, ego: int, rng: np.random.Generator) -> list[Drive]:
    """Returns the drives of `ego`: one at constant speed, and :data:`BRAKES` that brake at times drawn from `rng`.

    Each ends with the ego's log, or at the end of its logged path.

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
    """Returns the drive of the agent in `row`: as logged up to step `start`, then with `acceleration` (steps,) [m/s2].

    The agent must be there at step 0. It follows its logged path and does not reverse. The drive ends with the log, or
    at the end of the path.
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
    advances = np.append(np.diff(way) > 0.0, [True])  # the path has one point where the agent stood: the last one
    way = way[advances]
    pose = [np.interp(gone, way, values[advances]) for values in (x, y, yaw)]
    return Drive(int(log.ids[row]), kind, pose[0], pose[1], pose[2], speed[:count])
