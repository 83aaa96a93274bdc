"""Planted drivers under the measures that others publish: the recording has to win.

    ./litsim exec python benchmarks/likelihood/rows.py [--scenario demo us101_0750]

The ego drives its log. All vehicles around it at the end of the history are driven by the recording itself, at constant
velocity, or at random: accelerations and yaw rates are drawn at every step. Prints a table in Markdown: the likelihood
of the log as in the sim agents challenge (whole, and by groups of features), LitSim's realism, and the seven measures
of ReactSim-Bench.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.in_process import record
from litsim_sim.cli.program import program
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S, AgentTable, Controller, FloatArray
from litsim_sim.record.run import Run
from litsim_sim.scenario.policies import REPLAY
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

Drive = Callable[[np.random.Generator, int], FloatArray]
"""Accelerations [m/s2] and yaw rates [rad/s] (2, n) of n vehicles at a step."""

DRIVERS: dict[str, Drive | None] = {
    "recording": None,
    "constant velocity": lambda _, n: np.zeros((2, n)),
    "random": lambda random, n: random.normal(size=(2, n)) * [[2.0], [0.2]],
}
MEASURES: dict[str, tuple[str, str]] = {
    "`sim_agents.score`": ("sim_agents", "score"),
    "`.kinematic`": ("sim_agents", "kinematic"),
    "`.interaction`": ("sim_agents", "interaction"),
    "`.map`": ("sim_agents", "map"),
    "`realism.score`": ("realism", "score"),
    "`reactsim.ego_contacts`": ("reactsim", "ego_contacts"),
    "`.ego_short_ttc`": ("reactsim", "ego_short_ttc"),
    "`.contact_share`": ("reactsim", "contact_share"),
    "`.off_road`": ("reactsim", "off_road"),
    "`.wrong_way`": ("reactsim", "wrong_way"),
    "`.acceleration_infeasible`": ("reactsim", "acceleration_infeasible"),
    "`.curvature_infeasible`": ("reactsim", "curvature_infeasible"),
}
"""Fields of `metrics.json` by heading."""


def rows(scenario: Scenario) -> dict[str, dict[str, float]]:
    """Returns the measures by driver and heading."""
    run = record(RunPlan(scenario, "log", REPLAY, {}))
    return {name: _measures(driven(run, drive)) for name, drive in DRIVERS.items()}


def driven(run: Run, drive: Drive | None, seed: int = 0) -> Run:
    """Returns `run` with all vehicles around the ego at the end of its history driven from then on.

    Each goes on while its log does; `drive` is None for those that drive as recorded.
    """
    random, tables = np.random.default_rng(seed), list(run.tables)
    now = tables[run.info.history_steps]
    others = now.id[~now.obstacle & (now.id != run.info.ego_id)]
    for k in range(run.info.history_steps + 1, len(tables)):
        there = tables[k].rows(others)
        kept, at = there[there >= 0], now.rows(others[there >= 0])
        changed = {"controller": np.full(len(kept), Controller.POLICY, np.uint8)}
        if drive is not None:
            changed |= _moved(now, at, *drive(random, len(others))[:, there >= 0])
        tables[k] = now = _with(tables[k], kept, changed)
    return replace(run, tables=tables)


def _moved(table: AgentTable, rows: np.ndarray, acceleration: FloatArray, yaw_rate: FloatArray) -> dict[str, Any]:
    """Returns the columns (n,) of the agents in `rows` (n,) of `table` a step later."""
    speed = np.maximum(table.speed[rows] + acceleration * STEP_S, 0.0)
    yaw = wrap_angle(table.yaw[rows] + yaw_rate * STEP_S)
    x, y = table.x[rows] + speed * np.cos(yaw) * STEP_S, table.y[rows] + speed * np.sin(yaw) * STEP_S
    return {"x": x, "y": y, "yaw": yaw, "speed": speed, "acceleration": acceleration, "yaw_rate": yaw_rate}


def _with(table: AgentTable, rows: np.ndarray, columns: dict[str, Any]) -> AgentTable:
    """Returns `table` with the values of `columns` in `rows`."""
    changed = {name: getattr(table, name).copy() for name in columns}
    for name, values in columns.items():
        changed[name][rows] = values
    return replace(table, **changed)


def _measures(run: Run) -> dict[str, float]:
    """Returns the measures of a run by heading."""
    metrics = compute_metrics(run)
    return {heading: metrics[branch][leaf] for heading, (branch, leaf) in MEASURES.items()}


@program
def main(argv: list[str] | None = None) -> None:
    """Prints the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenario", nargs="+", default=["demo", "us101_0750"], help="packaged scenarios, or YAML files")
    columns = {
        f"{name}, {driver}": measures
        for name in p.parse_args(argv).scenario
        for driver, measures in rows(Scenario.load(name)).items()
    }
    print(f"| | {' | '.join(columns)} |\n|---|{'---|' * len(columns)}")
    for heading in MEASURES:
        print(f"| {heading} | {' | '.join(f'{measures[heading]:.3g}' for measures in columns.values())} |")


if __name__ == "__main__":
    main()
