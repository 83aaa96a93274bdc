"""Red lights that were run: who passed a stop line while its signals forbade it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import AgentTable, Controller
from litsim_sim.core.signals import STOP_STATES, SignalState
from litsim_sim.maps.signal_links import crossings
from litsim_sim.record.run import Run
from litsim_sim.scenario.signals import Signals


@dataclass(frozen=True)
class Passage:
    """An agent has passed a stop line.

    Attributes:
        agent: its id.
        step: first step at which it is past the line.
        connection: the way that it took over the junction, by the net's lanes.
        group: of the signals there.
        state: what they showed.
        controller: who moved the agent then.
    """

    agent: int
    step: int
    connection: str
    group: str
    state: SignalState
    controller: Controller

    @property
    def at_red(self) -> bool:
        """Whether nobody was allowed to pass."""
        return self.state in STOP_STATES


def passages(signals: Signals, tables: Sequence[AgentTable]) -> list[Passage]:
    """Which vehicles passed a stop line in `tables`, which are of successive steps; by agent and step.

    Signals of lanes are not for pedestrians and cyclists, who keep to none.
    """
    tables = [table.take(~table.obstacle) if table.obstacle.any() else table for table in tables]
    if not tables:
        return []
    ids = np.unique(np.concatenate([table.id for table in tables]))
    shape = (len(ids), len(tables))
    x, y, yaw, length = (np.zeros(shape) for _ in range(4))
    valid, controller = np.zeros(shape, np.bool_), np.zeros(shape, np.uint8)
    for column, table in enumerate(tables):
        rows = np.searchsorted(ids, table.id)
        for values, name in ((x, "x"), (y, "y"), (yaw, "yaw"), (length, "length"), (controller, "controller")):
            values[rows, column] = getattr(table, name)
        valid[rows, column] = True
    found = crossings(signals.links, x, y, yaw, length.max(axis=1), valid)
    made = []
    for agent, column, link in zip(found.agent.tolist(), found.step.tolist(), found.link.tolist(), strict=True):
        step, group = tables[column].step, int(signals.link_group[link])
        shown = signals.table(step).state[group] if signals.states.shape[1] else SignalState.UNAVAILABLE
        made.append(
            Passage(
                agent=int(ids[agent]),
                step=step,
                connection=signals.links[link].name,
                group=signals.groups[group],
                state=SignalState(int(shown)),
                controller=Controller(int(controller[agent, column])),
            )
        )
    return made


def run_passages(run: Run) -> list[Passage] | None:
    """Who passed a stop line after the history of a run; None where the scenario knows of no signals."""
    return None if run.signals is None else passages(run.signals, _driven(run, run.tables))


def log_passages(run: Run) -> list[Passage]:
    """Who passed a stop line in the recording, in the same time; empty where the scenario knows of no signals."""
    return [] if run.signals is None else passages(run.signals, _driven(run, run.log))


def _driven(run: Run, tables: Sequence[AgentTable]) -> list[AgentTable]:
    """From the last step of the history on: what is passed at the next step is passed from there."""
    return [table for table in tables if table.step >= run.info.history_steps]
