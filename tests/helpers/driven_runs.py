"""The loop closed around an ego that does as the test says."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.scene import STEP_S, AgentTable, Controller, EgoCommand
from litsim_sim.core.takeover import Takeover, TakeoverState
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation, Step
from litsim_sim.world.world import World

if TYPE_CHECKING:
    from litsim_sim.world.sumo import SumoMirror

Drive = Callable[[AgentTable, int], tuple[float, float]]
"""Acceleration [m/s2] and yaw rate [rad/s] of the ego, which is in the given row of the table."""


@dataclass(frozen=True)
class ScriptedEgo:
    """An ego that does as `drive` says."""

    ego_id: int
    drive: Drive

    def plan(self, table: AgentTable) -> EgoCommand:
        row = table.row(self.ego_id)
        return EgoCommand(table.step, *self.drive(table, row)) if row >= 0 else EgoCommand(table.step)


@dataclass(frozen=True)
class Driven:
    """A run, as far as tests look at it."""

    scenario: Scenario
    results: list[Step]
    world: World

    def takeovers(self, agent: int) -> dict[int, Takeover]:
        """What was said of `agent`, by step."""
        everybody = ((r.table.step, t) for r in self.results if r.takeovers for t in r.takeovers.takeovers)
        return {step: t for step, t in everybody if t.agent == agent}

    def life(self, agent: int) -> list[TakeoverState]:
        """States of `agent` in the order in which it went through them."""
        states = [t.state for t in self.takeovers(agent).values()]
        return states[:1] + [after for before, after in pairwise(states) if before != after]

    def series(self, agent: int, field: str) -> np.ndarray:
        """Values of a field of `agent` at the steps at which it is on the road."""
        tables = [r.table for r in self.results if r.table.row(agent) >= 0]
        return np.array([getattr(table, field)[table.row(agent)] for table in tables])

    def from_log(self, agent: int, step: int) -> float:
        """Distance of `agent` from its log [m]."""
        table, log = self.results[step].table, self.scenario.log.table(step)
        i, j = table.row(agent), log.row(agent)
        return float(np.hypot(table.x[i] - log.x[j], table.y[i] - log.y[j]))


def run(
    scenario: Scenario, ego: Drive | str, policy: str = "yield", mirror: SumoMirror | None = None, **config: Any
) -> Driven:
    """Run `scenario` in process; `ego` is the name of one that comes with LitSim, or says what to do."""
    scripted = None if isinstance(ego, str) else ScriptedEgo(scenario.ego_id, ego)
    plan = RunPlan(scenario, ego if isinstance(ego, str) else "log", policy, **config)
    simulation = Simulation.of(plan, mirror, ego=scripted)
    with closing(simulation.world):
        return Driven(scenario, list(simulation.steps()), simulation.world)


def placed(table: AgentTable, agent: int, **values: float) -> AgentTable:
    """`table` with other values for one agent."""
    fields = {name: getattr(table, name).copy() for name in values}
    for name, value in values.items():
        fields[name][table.row(agent)] = value
    return replace(table, **fields)


def farthest(speed: np.ndarray, then: np.ndarray, limits: VehicleLimits) -> np.ndarray:
    """Longest way [m] of a step from one speed to the other: as hard as can be on the throttle, then on the brake."""
    throttle, brake = limits.acceleration_max, limits.deceleration_max
    first = np.clip((then - speed + brake * STEP_S) / (throttle + brake), 0.0, STEP_S)
    peak, rest = speed + throttle * first, STEP_S - first
    return 0.5 * (speed + peak) * first + (peak - 0.5 * brake * rest) * rest


def beyond_limits(results: list[Step], controllers: tuple[Controller, ...]) -> list[tuple[int, int, str]]:
    """Step, agent and what it did that no vehicle can, of agents under one of `controllers` before and after."""
    limits, found = VehicleLimits(), []
    for before, after in pairwise(r.table for r in results):
        rows = after.rows(before.id)
        kept = (rows >= 0) & np.isin(before.controller, controllers) & np.isin(after.controller[rows], controllers)
        a, b = before.take(kept), after.take(rows[kept])
        moved = np.hypot(b.x - a.x, b.y - a.y)
        # the box centre lies ahead of the rear axle and swings out in a turn
        reach = farthest(a.speed, b.speed, limits) + limits.rear_axle * a.length * np.abs(b.yaw - a.yaw)
        checks = {
            "moved too far": moved > reach + 1e-6,
            "accelerated too hard": b.speed - a.speed > limits.acceleration_max * STEP_S + 1e-6,
            "braked too hard": a.speed - b.speed > limits.deceleration_max * STEP_S + 1e-6,
        }
        found += [(before.step, int(a.id[i]), what) for what, bad in checks.items() for i in np.flatnonzero(bad)]
    return found


@pytest.fixture(scope="session", name="drive")
def drive_fixture() -> Callable[..., Driven]:
    """Runs a scenario with an ego by name or by function; see `run`."""
    return run


@pytest.fixture(scope="session", name="placed")
def placed_fixture() -> Callable[..., AgentTable]:
    return placed


@pytest.fixture(scope="session", name="beyond_limits")
def beyond_limits_fixture() -> Callable[..., list[tuple[int, int, str]]]:
    return beyond_limits
