"""Goals of LitSim against replay and the baselines, and whether they are met."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from litsim_eval.analysis.measures.displacement import HORIZONS_S
from litsim_research.paper.experiments import DRIVEN_BY_BASELINES, OURS, PAPER_SETUP
from litsim_research.paper.measures import figure
from litsim_research.paper.tables import (
    ADE,
    ALL_SETS,
    BY_KEY,
    CONFLICTING_EGOS,
    NOTHING,
    SET_NAMES,
    Methods,
    markdown,
    parts_of,
)
from litsim_sim.scenario.policies import REPLAY


class GoalRow(NamedTuple):
    """What became of a goal on a set of roads.

    Attributes:
        ego: driver of the ego, or :data:`CONFLICTING_EGOS`.
        set: set of roads, or :data:`ALL_SETS`.
        goal: its text.
        replay, baseline, litsim, paper: values of replay, of the best baseline, of LitSim with its defaults and in the
            paper's configuration; `-` without one.
        best: the row of the best baseline.
        met: `yes`, `no` or `not measured`.
    """

    ego: str
    set: str
    goal: str
    replay: str
    baseline: str
    best: str
    litsim: str
    paper: str
    met: str


@dataclass(frozen=True)
class Goal:
    """A goal of LitSim.

    Attributes:
        text: the goal in words; `{}` stands for the horizon.
        measure: key of the measure concerned; `ade` is that at the last horizon that is measured.
        met: whether it is met, given LitSim's value and the best of the others.
        replay: whether replay is one of the others; it has no displacement and drives nobody by definition.
    """

    text: str
    measure: str
    met: Callable[[float, float], bool]
    replay: bool


GOALS = (
    Goal(
        "collision rate at most half of the best, %",
        "collision_beyond",
        lambda ours, best: ours <= best / 2,
        replay=True,
    ),
    Goal(
        "reactivity at least 97 %, highest",
        "reactivity_beyond",
        lambda ours, best: ours >= max(0.97, best),
        replay=True,
    ),
    Goal(
        "relevant ratio at most a sixth of the best, %", "relevant", lambda ours, best: ours <= best / 6, replay=False
    ),
    Goal("ADE at {} s lowest, m", "ade", lambda ours, best: ours < best, replay=False),
    Goal("realism highest", "realism", lambda ours, best: ours > best, replay=True),
)
"""Goals for LitSim against replay and the best of the baselines, on the same cases.

Contacts that are also in the log count for nobody: recorded boxes overlap in some windows, whatever is done."""


def goals(methods: Methods, ego: str, tag: str | None) -> list[GoalRow]:
    """Returns LitSim beside replay and the best baseline, and whether each goal is met; nothing without baselines."""
    rivals = [name for name in DRIVEN_BY_BASELINES if name in methods]
    if OURS not in methods or not rivals:
        return []
    values = {
        key: {name: value.value for name, of_method in parts.items() if (value := figure(of_method))}
        for key, parts in parts_of(methods, [*ADE, *(BY_KEY[g.measure] for g in GOALS if g.measure in BY_KEY)]).items()
    }
    last = max((h for h in HORIZONS_S if values[f"ade_{h}"]), default=HORIZONS_S[0])
    return [_reached(goal, values, rivals, last)._replace(ego=ego, set=tag or ALL_SETS) for goal in GOALS]


def _reached(goal: Goal, values: Mapping[str, Mapping[str, float]], rivals: Sequence[str], last: int) -> GoalRow:
    """Returns the row of a goal, given values by measure and method, and the last horizon of ADE [s]."""
    measure = BY_KEY[f"ade_{last}" if goal.measure == "ade" else goal.measure]
    by_method, text = values[measure.key], goal.text.format(last)
    shown = {name: measure.text(value) for name, value in by_method.items()}
    replay, ours, paper = (shown.get(name, NOTHING) for name in (REPLAY, OURS, PAPER_SETUP))
    theirs = {name: by_method[name] for name in rivals if name in by_method}
    assert measure.better is not None
    if OURS not in by_method or not theirs:
        return GoalRow("", "", text, replay, NOTHING, NOTHING, ours, paper, "not measured")
    best = measure.better(list(theirs.values()))
    others = [best, *([by_method[REPLAY]] if goal.replay and REPLAY in by_method else [])]
    met = "yes" if goal.met(by_method[OURS], measure.better(others)) else "no"
    name = next(name for name, value in theirs.items() if value == best)
    return GoalRow("", "", text, replay, measure.text(best), name, ours, paper, met)


def goals_table(records: Sequence[GoalRow]) -> list[str]:
    """Returns lines of a table of goals, with a row for each goal and set of roads."""
    return markdown(
        ["roads", "goal", "`replay`", "best baseline", "", f"`{OURS}`", f"`{PAPER_SETUP}`", "met"],
        [
            [_where(row), row.goal, row.replay, row.baseline, f"`{row.best}`", row.litsim, row.paper, row.met]
            for row in records
        ],
    )


def _where(row: GoalRow) -> str:
    return SET_NAMES[row.set] + ("" if row.ego == CONFLICTING_EGOS else f", ego `{row.ego}`")
