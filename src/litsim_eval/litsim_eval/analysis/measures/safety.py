"""Surrogate safety measures of the ego."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from litsim_data.surrogates.encroachment import encroachments
from litsim_data.surrogates.safety import TTC_CRITICAL_S, SafetySeries, safety_series, shortest_own_ttc
from litsim_eval.analysis.measure import (
    HIGHER,
    LOWER,
    Measure,
    Metrics,
    Row,
    Share,
    Span,
    Table,
    family,
    finite,
    least,
    mean_of,
)
from litsim_eval.analysis.measures.fault import contact_verdicts, new_contacts
from litsim_sim.record.run import Run


def series_of_ego(run: Run) -> SafetySeries:
    """Returns the ego's surrogate measures by step."""
    return safety_series(run.simulated, run.info.ego_id)


def _moment_of_shortest_ttc(run: Run, _: Metrics) -> Iterator[Span]:
    series = run.once(series_of_ego)
    if np.isfinite(series.ttc).any():
        step = int(series.step[np.argmin(series.ttc)])
        yield step, step


def _shortest(name: str) -> Callable[[Run], float | None]:
    """Returns the function of the smallest value of a series of the ego; None if it has none."""
    return lambda run: finite(getattr(run.once(series_of_ego), name).min(initial=np.inf))


def _own_ttc(run: Run) -> float | None:
    """Returns the shortest time to collision [s] that the ego causes: 0 for a contact that it answers for.

    Other agents count until their contact. Those that the ego touches in the log too do not count: their recorded
    boxes are too large, or too close.
    """
    if any(contact.blame.of_ego for contact in new_contacts(run)):
        return 0.0
    touched = {
        verdict.contact.agent: 0 if verdict.in_log else verdict.contact.step for verdict in run.once(contact_verdicts)
    }
    if touched:
        return finite(shortest_own_ttc(run.simulated, run.info.ego_id, touched))
    return _shortest("ttc")(run)


def _ttc_below(run: Run) -> dict[str, float | None]:
    return {str(limit): mean_of(run.once(series_of_ego).ttc < limit) for limit in TTC_CRITICAL_S}


def _max_drac(run: Run) -> float:
    drac = run.once(series_of_ego).drac
    return float(drac[np.isfinite(drac)].max(initial=0.0))


def _min_pet(run: Run) -> float | None:
    near = encroachments(run.simulated, run.info.ego_id)
    return near[0].pet if near else None


def _own_ttc_text(value: float, limit: str, metrics: Metrics) -> str:
    if metrics["fault"]["of_ego"]:
        return "shortest own TTC 0 s by that contact"
    return f"shortest own TTC {value:.2f} s, expected {limit} s"


LEAST = (Row(over=least, table=Table.EGO),)
MEASURES = family(
    "of the ego: shortest time to collision at constant speeds and headings within 3 s, with agents whose centre is "
    "ahead of its own, or that it touches",
    Measure(
        *("safety.min_ttc_s", _shortest("ttc"), "ego: shortest TTC", "s", HIGHER),
        rows=LEAST,
        moments=_moment_of_shortest_ttc,
    ),
    "the same as in nuPlan: agents that touch the ego count until they do, and a contact that the ego answers for "
    "counts as 0. Contacts that the log has too do not count",
    Measure(
        *("safety.min_own_ttc_s", _own_ttc, "ego: shortest own TTC", "s", HIGHER),
        sentence=_own_ttc_text,
        moments=_moment_of_shortest_ttc,
    ),
    "share of steps with a time to collision below 0.95 s (nuPlan) and 1.5 s",
    Share("safety.ttc_below", _ttc_below, "ego: TTC below {} s", "", LOWER, keys=tuple(map(str, TTC_CRITICAL_S))),
    "of the ego behind its leader: shortest time headway; largest deceleration to avoid a crash, over the steps "
    "without contact, 0 where the gap never closes",
    Measure("safety.min_headway_s", _shortest("headway"), "ego: shortest headway", "s", HIGHER, rows=LEAST),
    Measure("safety.max_drac_mps2", _max_drac, "ego: largest DRAC", "m/s²", LOWER),
    "shortest post-encroachment time of the ego with anybody",
    Measure("safety.min_pet_s", _min_pet, "ego: shortest PET", "s", HIGHER),
)
