"""Passages of stop lines, and which of them ran a red light."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import KNOWN_OF_EGO, LOWER, Count, Listed, Metrics, family, moments_of
from litsim_sim.core.scene import STEP_S, AgentTable, Controller, IntArray
from litsim_sim.core.signals import AMBER_STATES, STOP_STATES, SignalState
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.signal_links import crossings
from litsim_sim.record.run import Run
from litsim_sim.scenario.signals import Signals


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


REACTION_S, BRAKING_MPS2 = 1.0, 3.05  # within which amber times have drivers stop: ITE's kinematic equation
CELLS = 1_000_000
"""Most pairs of an agent and a step that are looked at together, which bounds the memory."""


def passages(signals: Signals, tables: Sequence[AgentTable]) -> list[Passage]:
    """Returns passages of stop lines by vehicles in `tables`, which are consecutive steps; sorted by agent and step.

    Pedestrians and cyclists are left out: they do not keep to lanes.
    """
    steps = Steps.of(tables)
    cells = max(1, CELLS // max(1, len(steps)))  # agents whose dense arrays are bounded
    return [
        passage
        for group, own in steps.groups(steps.ids.tolist())
        for k in range(0, len(group), cells)
        for passage in _passages_of(signals, own, np.array(group[k : k + cells]))
    ]


def _passages_of(signals: Signals, steps: Steps, agents: IntArray) -> list[Passage]:
    """Returns passages by `agents` (n,), of which there are few enough for dense arrays."""
    rows, table = steps.rows_of(agents).T, steps.stacked  # (agents, steps)
    rows = np.where(table.obstacle[rows], -1, rows)
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


def _could_stop(run: Run, passage: Passage) -> bool:
    """Returns whether the ego, that passed at amber, could stop when amber began: in its reaction time and by braking.

    Yellow change intervals are made for that (Institute of Transportation Engineers): who is farther away has to stop.
    """
    signals = run.signals
    if signals is None or passage.state not in AMBER_STATES:
        return False
    group, begin = signals.groups.index(passage.group), passage.step
    while begin > 0 and SignalState(int(signals.table(begin - 1).state[group])) in AMBER_STATES:
        begin -= 1
    track, table = run.steps.track(passage.agent), run.steps.stacked
    row = track[run.steps.step[table.number[track]] == begin]
    link = next(link for link in signals.links if link.name == passage.connection)
    away = (link.stop[0] - table.x[row]) * np.cos(link.heading) + (link.stop[1] - table.y[row]) * np.sin(link.heading)
    needed = 0.5 * table.length[row] + REACTION_S * table.speed[row] + table.speed[row] ** 2 / (2.0 * BRAKING_MPS2)
    return begin > 0 and bool((away >= needed).any())


def run_passages(run: Run) -> list[Passage] | None:
    """Returns passages after the history of a run, which is over at its last step; None without signals."""
    return None if run.signals is None else passages(run.signals, run.steps.after(run.info.history_steps - 1))


def log_passages(run: Run) -> list[Passage]:
    """Returns passages in the recording at the same steps; empty if the scenario has no signals."""
    return [] if run.signals is None else passages(run.signals, run.logged.after(run.info.history_steps - 1))


def red_lights(metrics: Metrics) -> Iterator[Mapping[str, Any]]:
    """Yields the stop lines that the ego passed at red."""
    yield from (passage for passage in metrics["signals"]["reds"] if passage["by"] == "ego")


def _red_text(_: Any, __: str, metrics: Metrics) -> str:
    texts = [f"{passage['connection']} at {STEP_S * passage['step']:.1f} s" for passage in red_lights(metrics)]
    return f"red light passed, {' and '.join(texts)}" if texts else ""


def _of_passages(read: Callable[[Run, list[Passage]], Any]) -> Callable[[Run], Any]:
    """Returns the function of what is read of a run's passages; None without signals."""

    def value(run: Run) -> Any:
        passed = run.once(run_passages)
        return None if passed is None else read(run, passed)

    return value


def _at_red(_: Run, passed: list[Passage]) -> list[dict[str, Any]]:
    names = ("agent", "step", "connection", "group")
    return [
        {**{name: getattr(passage, name) for name in names}, "by": passage.controller.name.lower()}
        for passage in passed
        if passage.at_red
    ]


MEASURES = family(
    "stop lines passed by vehicles, and those passed by the ego at red ([signals](signals.md#where-they-show)); null "
    "if the scenario has no signals",
    Count("signals.passed", _of_passages(lambda _, passed: len(passed))),
    Count(
        "signals.red_ego",
        _of_passages(
            lambda run, passed: sum(passage.at_red and passage.agent == run.info.ego_id for passage in passed)
        ),
        *("ego: red lights passed", "", LOWER),
        rows=KNOWN_OF_EGO,
        sentence=_red_text,
        moments=moments_of(red_lights),
    ),
    "stop lines that the ego passed at amber although it could stop when amber began: within 1 s and by 3.05 m/s² "
    "(Institute of Transportation Engineers)",
    Count(
        "signals.amber_ego",
        _of_passages(lambda run, passed: sum(_could_stop(run, by) for by in passed if by.agent == run.info.ego_id)),
        *("ego: amber lights run", "", LOWER),
        rows=KNOWN_OF_EGO,
    ),
    "stop lines passed at red by agents under control, and in the recording; each passage at red",
    Count(
        "signals.red_controlled",
        _of_passages(
            lambda _, passed: sum(passage.at_red and passage.controller == Controller.POLICY for passage in passed)
        ),
        better=LOWER,
    ),
    Count("signals.red_log", _of_passages(lambda run, _: sum(passage.at_red for passage in run.once(log_passages)))),
    Listed("signals.reds", _of_passages(_at_red)),
)
