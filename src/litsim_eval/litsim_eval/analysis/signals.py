"""Passages of stop lines, and which of them ran a red light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import AgentTable, Controller, IntArray
from litsim_sim.core.signals import STOP_STATES, SignalState
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.signal_links import crossings
from litsim_sim.record.run import Run
from litsim_sim.scenario.signals import Signals

CELLS = 1_000_000
"""Most pairs of an agent and a step that are looked at together, which bounds the memory."""


@dataclass(frozen=True)
class Passage:
    """A passage of a stop line by an agent.

    Attributes:
        agent: its id.
        step: first step at which it is past the line.
        connection: connection of the net's lanes by which it crossed the junction.
        group: signal group of the connection.
        state: state of the group at that step.
        controller: controller of the agent at that step.
    """

    agent: int
    step: int
    connection: str
    group: str
    state: SignalState
    controller: Controller

    @property
    def at_red(self) -> bool:
        """Whether the signals forbade passing."""
        return self.state in STOP_STATES


def passages(signals: Signals, tables: Sequence[AgentTable]) -> list[Passage]:
    """Returns passages of stop lines by vehicles in `tables`, which are consecutive steps; sorted by agent and step.

    Pedestrians and cyclists are left out: they do not keep to lanes.
    """
    steps = Steps(table.take(~table.obstacle) if table.obstacle.any() else table for table in tables)
    if not len(steps.ids):
        return []
    some = max(1, CELLS // len(steps))
    parts = (steps.ids[k : k + some] for k in range(0, len(steps.ids), some))
    return [passage for agents in parts for passage in _passages_of(signals, steps, agents)]


def _passages_of(signals: Signals, steps: Steps, agents: IntArray) -> list[Passage]:
    """Returns passages by `agents` (n,), of which there are few enough for dense arrays."""
    rows, table = steps.rows_of(agents).T, steps.stacked  # (agents, steps)
    x, y, yaw, length, controller = (
        np.where(rows >= 0, getattr(table, name)[rows], 0) for name in ("x", "y", "yaw", "length", "controller")
    )
    crossed = crossings(signals.links, x, y, yaw, length.max(axis=1), rows >= 0)
    passed = []
    for agent, column, link in zip(crossed.agent.tolist(), crossed.step.tolist(), crossed.link.tolist(), strict=True):
        step, group = int(steps.step[column]), int(signals.link_group[link])
        shown = signals.table(step).state[group] if signals.states.shape[1] else SignalState.UNAVAILABLE
        passed.append(
            Passage(
                agent=int(agents[agent]),
                step=step,
                connection=signals.links[link].name,
                group=signals.groups[group],
                state=SignalState(int(shown)),
                controller=Controller(int(controller[agent, column])),
            )
        )
    return passed


def run_passages(run: Run) -> list[Passage] | None:
    """Returns passages after the history of a run; None if the scenario has no signals."""
    return None if run.signals is None else passages(run.signals, _driven(run, run.tables))


def log_passages(run: Run) -> list[Passage]:
    """Returns passages in the recording at the same steps; empty if the scenario has no signals."""
    return [] if run.signals is None else passages(run.signals, _driven(run, run.log))


def _driven(run: Run, tables: Sequence[AgentTable]) -> list[AgentTable]:
    """Returns the tables from the last step of the history on: a passage needs the step before it."""
    return [table for table in tables if table.step >= run.info.history_steps]
