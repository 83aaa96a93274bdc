"""One step of the agents under control: their commands, their actuators and limits, and where they leave the road."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from litsim_sim.core.dynamics import Motion, VehicleLimits, bicycle_step
from litsim_sim.core.scene import (
    AgentTable,
    Controller,
    ControlSource,
    ControlTable,
    EgoCommand,
    FloatArray,
    IntArray,
    index_of,
)
from litsim_sim.core.vehicle import Actuators
from litsim_sim.kernels.compiled import Floats, kernel
from litsim_sim.scenario.setting import Setting

# numpy compares plain numbers much faster than members of an enumeration
POLICY, EGO, LATE = int(Controller.POLICY), int(Controller.EGO), int(ControlSource.LATE)
BACKGROUND = VehicleLimits()  # of all vehicles but the egos, whose model is the scenario's


def check_answers(step: int, ego_ids: IntArray, controls: ControlTable, egos: Sequence[EgoCommand]) -> None:
    """Raise ValueError if the answers to a step cannot be applied.

    They answer another step or hold non-finite values, or the ids of `controls` do not ascend or list an ego.
    """
    for ego in egos:
        if controls.step != step or ego.step != step:
            raise ValueError(f"answers to steps {controls.step} (controls) and {ego.step} (ego), expected {step}")
        if not (math.isfinite(ego.acceleration) and math.isfinite(ego.yaw_rate)):
            raise ValueError(f"ego control at step {step} is not finite: {ego.acceleration}, {ego.yaw_rate}")
    if not _finite(controls.acceleration, controls.lateral_acceleration, controls.yaw_rate):
        raise ValueError(f"controls at step {step} are not finite")
    if (controls.id[1:] <= controls.id[:-1]).any():
        raise ValueError(f"ids of the controls at step {step} do not ascend: {controls.id.tolist()}")
    for ego_id in ego_ids[index_of(controls.id, ego_ids) >= 0].tolist():
        raise ValueError(f"controls at step {step} list the ego, {ego_id}, which has a port of its own")


@kernel
def _finite(acceleration: Floats, lateral_acceleration: Floats, yaw_rate: Floats) -> bool:
    """Returns whether all numbers of three arrays (n,) are finite."""
    for values in (acceleration, lateral_acceleration, yaw_rate):
        for value in values:
            if not math.isfinite(value):
                return False
    return True


class DrivenVehicles:
    """Moves the agents that are under control, by a kinematic bicycle model."""

    def __init__(self, scenario: Setting) -> None:
        self._scenario, self._ego_ids = scenario, scenario.ego_ids
        self._actuators = [Actuators(scenario.vehicle) for _ in self._ego_ids]
        self._egos_differ = any(
            getattr(BACKGROUND, f.name) != getattr(scenario.vehicle, f.name) for f in fields(BACKGROUND)
        )

    def reset(self, scene: int = 0) -> None:
        """Forget the commands to the actuators of a scene's ego: it begins, or is back on its log."""
        self._actuators[scene].reset()

    def step(self, table: AgentTable, controls: ControlTable, egos: Sequence[EgoCommand | None]) -> AgentTable:
        """Returns the agents under control one step after `table` that were on the road, ids ascending.

        Controls with source LATE are left out, as their agents follow their logs, and so are egos without a
        command. Agents that left the net after the end of their logs are gone, except egos.
        """
        stay = controls.source != LATE
        ids, acceleration, yaw_rate = controls.id[stay], controls.acceleration[stay], controls.yaw_rate[stay]
        controller = np.full(len(ids), POLICY)
        driving = [k for k, ego in enumerate(egos) if ego is not None]
        if driving:
            effects = np.array([self._actuate(table, k, ego) for k, ego in enumerate(egos) if ego is not None])
            ids = np.concatenate([ids, self._ego_ids[driving]])
            acceleration = np.concatenate([acceleration, effects[:, 0]])
            yaw_rate = np.concatenate([yaw_rate, effects[:, 1]])
            controller = np.concatenate([controller, np.full(len(driving), EGO)])
        rows = table.rows(ids)
        listed = rows >= 0
        rows, order = rows[listed], rows[listed].argsort(kind="stable")
        now = table.take(rows[order])
        moved = self._move(now, acceleration[listed][order], yaw_rate[listed][order])
        driven = AgentTable(
            table.step + 1,
            now.id,
            now.kind,
            controller[listed][order].astype(np.uint8),
            moved.x,
            moved.y,
            moved.yaw,
            moved.speed,
            moved.acceleration,
            moved.yaw_rate,
            now.length,
            now.width,
            now.scene,
        )
        log = self._scenario.log
        stays = log.last_step[log.ids.searchsorted(driven.id)] > table.step
        stays |= driven.mask(self._ego_ids)  # they leave by an end of the net, whatever their logs
        if stays.all():
            return driven
        return driven.take(stays | self._scenario.lane_map.inside_road(driven.x, driven.y))

    def _actuate(self, table: AgentTable, scene: int, ego: EgoCommand) -> tuple[float, float]:
        """Returns the acceleration [m/s2] and yaw rate [rad/s] that the actuators of an ego make of its command."""
        row = table.row(int(self._ego_ids[scene]))
        moving = float(table.acceleration[row]), float(table.yaw_rate[row])
        return self._actuators[scene].apply(ego.acceleration, ego.yaw_rate, moving, float(table.speed[row]))

    def _move(self, now: AgentTable, acceleration: FloatArray, yaw_rate: FloatArray) -> Motion:
        """Returns the motion of the agents of `now` one step on, each within the limits of its vehicle."""
        motion = Motion(now.x, now.y, now.yaw, now.speed, now.acceleration, now.yaw_rate)
        moved = bicycle_step(motion, now.length, acceleration, yaw_rate, BACKGROUND)
        if self._egos_differ and (of_egos := now.mask(self._ego_ids)).any():
            alone = Motion(*(values[of_egos] for values in motion))
            egos = bicycle_step(
                alone, now.length[of_egos], acceleration[of_egos], yaw_rate[of_egos], self._scenario.vehicle
            )
            for values, of_ego in zip(moved, egos, strict=True):
                values[of_egos] = of_ego
        return moved
