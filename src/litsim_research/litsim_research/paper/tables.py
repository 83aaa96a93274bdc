"""The paper's tables in Markdown, made from campaigns: a row per method, and rows of the paper's own figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from litsim_eval.analysis.displacement import HORIZONS_S
from litsim_eval.analysis.summary import Metrics
from litsim_eval.campaign.results import Campaign, RunResult
from litsim_research.baselines import BASELINES
from litsim_research.paper.experiments import OURS, PAPER_EGO
from litsim_research.paper.measures import (
    Key,
    Parts,
    Whose,
    ade_parts,
    by_key,
    count,
    figure,
    interval,
    run_parts,
)
from litsim_research.paper.published import OTHER_DATA
from litsim_sim.scenario.run_info import REPLAY

NOTHING = "-"
CLEAR = "\\*"
"""Marks a clear difference from LitSim: its interval excludes zero."""

Methods = Mapping[str, Mapping[Key, Metrics | None]]


@dataclass(frozen=True)
class Measure:
    """A column.

    Attributes:
        key: its key in :mod:`.measures` and :mod:`.published`.
        heading: with the unit.
        better: `min` or `max`, whichever is better; None if neither is.
        scale: factor applied to values.
        digits: digits after the point.
    """

    key: str
    heading: str
    better: Callable[[Sequence[float]], float] | None
    scale: float = 1.0
    digits: int = 2

    def text(self, value: float) -> str:
        """`value` as the text of a cell."""
        return f"{self.scale * value:.{self.digits}f}"


ADE = tuple(Measure(f"ade_{h}", f"ADE {h} s, m", min) for h in HORIZONS_S)
OF_THE_PAPER = (
    *ADE,
    Measure("collision", "collision %", min, 100.0),
    Measure("reactivity", "reactivity %", max, 100.0, 1),
    Measure("progress", "progress, m", None, digits=1),
    Measure("relevant", "relevant %", min, 100.0),
)
"""Columns of Table II, by the paper's definitions."""

BESIDE = (
    *(Measure(f"own_{h}", f"own ADE {h} s, m", None) for h in HORIZONS_S),
    *(Measure(f"all_{h}", f"ADE of all {h} s, m", min) for h in HORIZONS_S),
    Measure("collision_beyond", "collision %, log's excluded", min, 100.0),
    Measure("collision_driven", "collision %, driven", min, 100.0),
    Measure("collision_driven_beyond", "collision %, driven, log's excluded", min, 100.0),
    Measure("reactivity_beyond", "reactivity %, log's excluded", max, 100.0, 1),
    Measure("relevant_ours", "relevant %, all taken over", min, 100.0),
    Measure("off_road", "off road %, driven", min, 100.0),
    Measure("realism", "realism", max, digits=3),
)
"""Further columns, by LitSim's definitions where they differ from the paper's."""


@dataclass(frozen=True)
class Goal:
    """A goal of LitSim against the baselines.

    Attributes:
        text: the goal in words.
        measure: the measure concerned.
        met: whether it is met, given LitSim's value and the best of the baselines.
    """

    text: str
    measure: Measure
    met: Callable[[float, float], bool]


GOALS = (
    Goal("collision rate at most half of the best", OF_THE_PAPER[len(ADE)], lambda ours, best: ours <= best / 2),
    Goal("reactivity at least 97 %", OF_THE_PAPER[len(ADE) + 1], lambda ours, _: ours >= 0.97),
    Goal("relevant ratio at most a sixth of the best", OF_THE_PAPER[-1], lambda ours, best: ours <= best / 6),
    Goal("ADE at 25 s lowest", ADE[-1], lambda ours, best: ours < best),
    Goal("realism highest", BESIDE[-1], lambda ours, best: ours > best),
)
"""Goals for LitSim against the best of the baselines, on the same cases."""

COUNTED = {
    "fault_background": "background's fault",
    "fault_ego_avoidable": "ego's fault, avoidable by the other",
    "fault_ego": "ego's fault, unavoidable",
    "takeovers": "takeovers",
    "hard_brakes": "hard brakes",
}
"""Headings of counts, by key in :mod:`.measures`."""


def methods_of(campaign: Campaign, ego: str, tag: str | None) -> dict[str, dict[Key, Metrics | None]]:
    """Metrics of the runs of each method with `ego` on the set `tag` (None: all sets), in the campaign's order."""
    found: dict[str, list[RunResult]] = {}
    for result in campaign.results:
        if result.case.ego.name == ego and (tag is None or tag in result.case.tags):
            found.setdefault(result.case.label or result.case.policy, []).append(result)
    return {name: by_key(results) for name, results in found.items()}


def parts_of(methods: Methods, measures: Sequence[Measure]) -> dict[str, dict[str, Parts]]:
    """Contributions of the runs to each measure, by the measure's key, then by method."""
    found: dict[str, dict[str, Parts]] = {}
    for measure in measures:
        kind, _, horizon = measure.key.rpartition("_")
        if kind in ("ade", "all"):
            whose: Whose = "driven" if kind == "ade" else "all"
            found[measure.key] = ade_parts(methods, int(horizon), whose)
        elif kind == "own":
            alone = {name: ade_parts({name: runs}, int(horizon), "driven") for name, runs in methods.items()}
            found[measure.key] = {name: parts[name] for name, parts in alone.items()}
        else:
            found[measure.key] = {name: run_parts(runs, measure.key) for name, runs in methods.items()}
    return found


def table(
    methods: Methods, measures: Sequence[Measure], published: Mapping[str, Mapping[str, float]] | None = None
) -> list[str]:
    """Lines of a table of values with spreads over draws: best in bold, clear differences from LitSim marked."""
    parts = parts_of(methods, measures)
    shown = [measure for measure in measures if any(figure(each) for each in parts[measure.key].values())]
    lines = [_line(["", "runs", *(measure.heading for measure in shown)]), _line(["---", *["---:"] * (len(shown) + 1)])]
    best = {measure.key: _best(measure, parts[measure.key]) for measure in shown}
    for name, runs in methods.items():
        cells = [_cell(measure, parts[measure.key], name, best[measure.key]) for measure in shown]
        lines.append(_line([f"`{name}`", _runs(runs), *cells]))
    for name, values in (published or {}).items():
        cells = [measure.text(values[measure.key]) if measure.key in values else "" for measure in shown]
        lines.append(_line([f"*{name}: {OTHER_DATA}*", "", *cells]))
    return lines


def differences(methods: Methods, measures: Sequence[Measure]) -> list[str]:
    """Lines of a table of each other method minus LitSim, with confidence intervals; none without LitSim."""
    parts = parts_of(methods, measures)
    if OURS not in methods:
        return []
    shown = [measure for measure in measures if figure(parts[measure.key][OURS])]
    lines = [
        _line([f"minus `{OURS}`", *(measure.heading for measure in shown)]),
        _line(["---", *["---:"] * len(shown)]),
    ]
    for name in methods:
        if name in (OURS, REPLAY):
            continue
        cells = [_difference(measure, parts[measure.key][OURS], parts[measure.key][name]) for measure in shown]
        lines.append(_line([f"`{name}`", *cells]))
    return lines


def counts(methods: Methods) -> list[str]:
    """Lines of a table of takeovers, hard brakes, and contacts not in the log by fault."""
    lines = [_line(["", *COUNTED.values()]), _line(["---", *["---:"] * len(COUNTED)])]
    for name, runs in methods.items():
        lines.append(_line([f"`{name}`", *(str(count(runs, key)) for key in COUNTED)]))
    return lines


def won(methods: Methods, measures: Sequence[Measure]) -> list[str]:
    """A line for each measure in which another method beats LitSim; replay, which does not react, is left out."""
    parts = parts_of(methods, measures)
    found = []
    for measure in measures:
        ours = parts[measure.key].get(OURS, {})
        mine = figure(ours)
        if mine is None or measure.better is None:
            continue
        others = []
        for name in methods:
            theirs = figure(parts[measure.key][name])
            if name in (OURS, REPLAY) or theirs is None or theirs.value == mine.value:
                continue
            if measure.better([theirs.value, mine.value]) == theirs.value:
                clear = CLEAR if _clear(ours, parts[measure.key][name]) else ""
                others.append(f"`{name}` {measure.text(theirs.value)}{clear}")
        if others:
            found.append(f"- {measure.heading}, {measure.text(mine.value)} with `{OURS}`: {', '.join(others)}.")
    return found


def goals(methods: Methods) -> list[str]:
    """Lines of a table of goals: LitSim beside the best of the baselines, and whether each goal is met."""
    rivals = [name for name in BASELINES if name in methods]
    if OURS not in methods or not rivals:
        return []
    lines = [_line(["goal", f"`{OURS}`", "best of the baselines", "met"]), _line(["---", "---:", "---:", "---"])]
    parts = parts_of({name: methods[name] for name in (OURS, *rivals)}, [goal.measure for goal in GOALS])
    for goal in GOALS:
        mine = figure(parts[goal.measure.key][OURS])
        theirs = [found.value for name in rivals if (found := figure(parts[goal.measure.key][name]))]
        if mine is None or not theirs or goal.measure.better is None:
            lines.append(_line([goal.text, NOTHING, NOTHING, "not measured"]))
            continue
        best = goal.measure.better(theirs)
        met = "yes" if goal.met(mine.value, best) else "no"
        lines.append(_line([goal.text, goal.measure.text(mine.value), goal.measure.text(best), met]))
    return lines


def titled(ego: str, tag: str | None) -> str:
    """Heading of the tables of an ego and a set."""
    where = {"real": "real window us101_0750", "highway": "generated motorway", "urban": "generated street"}
    as_paper = ", as in the paper" if ego == PAPER_EGO else ""
    return f"Ego `{ego}`{as_paper}; {where.get(tag or '', 'all sets together')}"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _runs(runs: Mapping[Key, Metrics | None]) -> str:
    failed = sum(metrics is None for metrics in runs.values())
    return f"{len(runs)}, {failed} failed" if failed else str(len(runs))


def _best(measure: Measure, parts: Mapping[str, Parts]) -> str | None:
    """Text of the best value of a column, without replay; None if there is none."""
    values = [found.value for name, each in parts.items() if name != REPLAY and (found := figure(each))]
    return measure.text(measure.better(values)) if measure.better and values else None


def _cell(measure: Measure, parts: Mapping[str, Parts], name: str, best: str | None) -> str:
    found = figure(parts[name])
    if found is None:
        return NOTHING
    text = measure.text(found.value)
    text = f"**{text}**" if text == best and name != REPLAY else text
    spread = "" if found.spread is None else f" ± {measure.text(found.spread)}"
    clear = OURS in parts and name not in (OURS, REPLAY) and _clear(parts[OURS], parts[name])
    return f"{text}{spread}{CLEAR if clear else ''}"


def _clear(ours: Parts, theirs: Parts) -> bool:
    bounds = interval(ours, theirs)
    return bounds is not None and (bounds[0] > 0.0 or bounds[1] < 0.0)


def _difference(measure: Measure, ours: Parts, theirs: Parts) -> str:
    both = ({key: parts[key] for key in ours if key in theirs} for parts in (ours, theirs))  # those of the bounds
    bounds, mine, other = interval(ours, theirs), *map(figure, both)
    if bounds is None or mine is None or other is None:
        return NOTHING
    low, high = (measure.text(bound) for bound in bounds)
    return f"{measure.text(other.value - mine.value)} [{low}, {high}]"
