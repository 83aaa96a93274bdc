"""The page of credibility: the table, distributions beside people's, and encounters over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.reaction import BY_BOXES, box_gaps, path_gaps
from litsim_eval.credibility.charts import Chart, Line, shares_up_to, span
from litsim_eval.credibility.measures import QUANTITIES, mean_distance
from litsim_eval.credibility.responses import Responses
from litsim_eval.credibility.results import Results, judged
from litsim_eval.credibility.table import COLUMNS, LEGEND, MORE_COLUMNS, sections, words
from litsim_eval.report.pages import render_page
from litsim_eval.report.wording import leaf
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.io.files import write_text
from litsim_sim.scenario.encounter_note import Track

PAGE_FILE = "credibility.html"
BEFORE_STEPS = 30  # of the pictures of encounters over time, before the onset: 3 s
SLOPE_STEPS = 5  # over which a shown acceleration is a mean: 0.5 s, as for the strongest braking
SHOWN_TTC_MAX = 12.0  # [s] up to which times to collision are shown
PICTURED = ((0.5, "usual"), (0.9, "hard"))
"""Encounters of each kind that are pictured: share of those in which people lost less speed, and what that means."""

MORE = (
    "kappa: agreement beyond chance on a time to collision below 2.5 s, a gap below 2 m or braking above 2.5 m/s²; "
    "politeness: least gap minus people's, median; heroism: share that brakes harder than anyone in encounters of "
    "the kind"
)


def write_page(results: Results, command: str, path: Path) -> None:
    """Writes the page of `results` of a `command`; raises InputError if that is impossible."""
    drives, columns = results.drives, (*COLUMNS, *MORE_COLUMNS)
    page = render_page(
        "credibility.html.j2",
        title=f"Credibility of {', '.join(results.responses)}",
        subtitle=_subtitle(results),
        heads=[column.head for column in columns],
        sections=list(sections(results, columns)),
        legend=f"{LEGEND}; {MORE}",
        bars=_bars(results),
        names=[(name, colour) for colour, name in enumerate(drives)],
        distributions=[_distribution(quantity, drives).drawn() for quantity in QUANTITIES],
        pictures=list(_pictures(results)),
        failures=results.failures,
        about=[("command", command), *((name, str(text)) for name, text in results.versions.items())],
    )
    write_text(path, page)


def _subtitle(results: Results) -> str:
    """Returns which encounters there are, in words."""
    kinds = Counter(words(encounter.note.kind) for encounter in results.encounters)
    sites = Counter(encounter.note.site for encounter in results.encounters)
    texts = [", ".join(f"{count} {name}" for name, count in counts.items()) for counts in (kinds, sites)]
    drivers = f" · {results.drivers} drivers in each" if results.drivers > 1 else ""
    return f"{len(results.encounters)} encounters: {texts[0]} · {texts[1]}{drivers}"


def _bars(results: Results) -> list[dict[str, Any]]:
    """Returns a row for each bar, with its verdicts on all setups."""
    verdicts = [judged(own) for own in results.measures.values()]
    return [
        {"name": row[0].name, "limit": row[0].limit, "cells": [(leaf(result.value), result.passed) for result in row]}
        for row in zip(*verdicts, strict=True)
    ]


def _distribution(quantity: str, drives: Mapping[str, Responses]) -> Chart:
    """Returns the chart of a quantity's distributions."""
    values = {name: getattr(own.simulated, quantity) for name, own in drives.items()}
    shown = span(list(values.values()))
    if quantity == "least_ttc":
        shown = 0.0, SHOWN_TTC_MAX
    lines = [shares_up_to(name, colour, own, shown) for colour, (name, own) in enumerate(values.items())]
    unit, text = QUANTITIES[quantity]
    return Chart(f"{text} [{'m/s²' if unit == 'mps2' else unit.replace('mps', 'm/s')}]", lines, shown, (0.0, 1.0))


def _pictures(results: Results) -> Iterator[dict[str, Any]]:
    """Yields the pictured encounters: a usual and a hard one of each kind."""
    lost = results.people.people.speed_lost
    for kind, rows in results.people.kinds.items():
        ranked = rows[lost[rows].argsort(kind="stable")].tolist()
        for row, what in {ranked[int(share * (len(ranked) - 1))]: what for share, what in PICTURED}.items():
            encounter = results.encounters[row]
            yield {
                "title": f"{words(kind)}, {what}: {encounter.name}",
                "errors": _errors(results, encounter),
                "charts": [chart.drawn() for chart in _over_time(results, encounter)],
            }


def _errors(results: Results, encounter: Encounter) -> str:
    """Returns the position errors of all setups in an encounter, in words."""
    errors = {
        name: mean_distance(own.along[[row]])[0]
        for name, own in results.responses.items()
        for row in [own.row(encounter)]
        if row is not None
    }
    return ", ".join(f"{name} {error:.1f} m" for name, error in errors.items())


def _over_time(results: Results, encounter: Encounter) -> Iterator[Chart]:
    """Yields the charts of an encounter: gap, speed and acceleration of people and each setup's first driver."""
    series = {
        name: _series(encounter, own.drives[row][0].track)
        for name, own in results.drives.items()
        for row in [own.row(encounter)]
        if row is not None
    }
    ends = -BEFORE_STEPS * STEP_S, (len(encounter.truth) - 1 - encounter.note.onset_step) * STEP_S
    colours = {name: colour for colour, name in enumerate(results.drives)}
    for number, title in enumerate(("gap [m]", "speed [m/s]", "acceleration [m/s²]")):
        lines = [Line(name, colours[name], own[0], own[1 + number]) for name, own in series.items()]
        yield Chart(title, lines, ends, span([line.y for line in lines], 0.0), mark=0.0)


def _series(encounter: Encounter, track: Track) -> tuple[FloatArray, ...]:
    """Returns time from the onset, gap, speed and acceleration (T,) of an agent on `track` [s, m, m/s, m/s2]."""
    begin = max(encounter.note.onset_step - BEFORE_STEPS, 0)
    end = min(len(track), len(encounter.opponent_truth))
    own, other = (whole.part(begin, end) for whole in (track, encounter.opponent_truth))
    gap, _ = (box_gaps if encounter.note.kind in BY_BOXES else path_gaps)(own, other, *encounter.sizes)
    speed = own.speed
    acceleration = np.full(len(speed), np.nan)
    acceleration[SLOPE_STEPS:] = (speed[SLOPE_STEPS:] - speed[:-SLOPE_STEPS]) / (SLOPE_STEPS * STEP_S)
    time = STEP_S * (begin - encounter.note.onset_step + np.arange(len(gap), dtype=np.float64))
    return time, gap, speed, acceleration
