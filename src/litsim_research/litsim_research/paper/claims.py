"""What the paper says of its results in words, and in how many of our tables each claim holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from litsim_eval.analysis.measures.displacement import HORIZONS_S
from litsim_research.paper.experiments import DRIVEN_BY_BASELINES, OURS, PAPER_SETUP
from litsim_research.paper.tables import ALL_SETS, CONFLICTING_EGOS, NOTHING, PUBLISHED, ClaimRow, Row, markdown
from litsim_sim.scenario.policies import REPLAY

Values = Mapping[str, Mapping[str, float]]
"""A table with one ego on one set of roads: values by measure, then by method."""
RIVALS = DRIVEN_BY_BASELINES
EVERYBODY = (REPLAY, *RIVALS)
SHORT_S = 15  # [s] up to which the paper calls a simulation short
SHORT, LONG = (tuple(f"ade_{h}" for h in HORIZONS_S if (h <= SHORT_S) == short) for short in (True, False))
LAST = "ade_last"
"""Key of ADE at the last horizon that a table has."""


class Claim(NamedTuple):
    """A claim that a method is better than others in each of some measures.

    Attributes:
        text: the claim.
        measures: keys of the measures.
        method, than: names of rows, `OURS` for the one that is LitSim.
        most: whether higher values are better.
    """

    text: str
    measures: Sequence[str]
    method: str
    than: Sequence[str]
    most: bool = False

    def holds(self, table: Values, ours: str) -> bool | None:
        """Returns whether it holds in a table whose row `ours` is LitSim; None where the table does not tell."""

        def value(measure: str, name: str) -> float | None:
            return table.get(measure, {}).get(ours if name == OURS else name)

        pairs = [(value(m, self.method), value(m, other)) for m in self.measures for other in self.than]
        told = [(own, other) for own, other in pairs if own is not None and other is not None]
        return all(own > other if self.most else own < other for own, other in told) if told else None


CLAIMS = (
    Claim("up to 15 s, IDM is nearest to the log", SHORT, "idm", (OURS, "gail", "simnet")),
    Claim("beyond 15 s, LitSim is nearest to the log", LONG, OURS, RIVALS),
    Claim("LitSim has the lowest collision rate", ("collision_beyond",), OURS, EVERYBODY),
    Claim("LitSim has the highest reactivity", ("reactivity_beyond",), OURS, EVERYBODY, most=True),
    Claim("LitSim has fewest contacts at the background's fault", ("fault_background",), OURS, EVERYBODY),
    Claim("LitSim has fewest contacts at the ego's fault", ("fault_ego",), OURS, EVERYBODY),
    Claim("LitSim has the lowest relevant ratio, apart from replay", ("relevant",), OURS, RIVALS),
    Claim("of IDM, GAIL and SimNet, SimNet collides least", ("collision_beyond",), "simnet", ("idm", "gail")),
    Claim("GAIL makes most progress", ("progress",), "gail", (OURS, "idm", "simnet"), most=True),
)
"""Of Table II; LitSim is compared with each baseline in both of its rows, and with replay where that is not perfect by
definition."""

ABLATION_CLAIMS = (
    Claim("joint forecasts bring agents nearer to the log (M1, M0)", (LAST,), "M1", ("M0",)),
    Claim("joint forecasts avoid collisions (M1, M0)", ("collision_beyond",), "M1", ("M0",)),
    Claim("policy C brings agents nearer to the log (M2, M1)", (LAST,), "M2", ("M1",)),
    Claim("policy C avoids collisions (M2, M1)", ("collision_beyond",), "M2", ("M1",)),
    Claim("the larger ROI brings agents nearer to the log (M\\*, M2)", (LAST,), PAPER_SETUP, ("M2",)),
)
"""Of the ablation study, all of whose rows have the paper's configuration; M* is :data:`PAPER_SETUP`."""


def claim_rows(table: Sequence[Row], ablation: Sequence[Row]) -> list[ClaimRow]:
    """Returns in how many tables the claims hold, given the rows of Table II and of the ablation study."""
    tables, ablations = _tables(table), _tables(ablation)
    return [
        *(ClaimRow(claim.text, _count(claim, tables, OURS), _count(claim, tables, PAPER_SETUP)) for claim in CLAIMS),
        *(ClaimRow(claim.text, NOTHING, _count(claim, ablations, PAPER_SETUP)) for claim in ABLATION_CLAIMS),
    ]


def claims_table(records: Sequence[ClaimRow]) -> list[str]:
    """Returns the lines of the table of claims."""
    return markdown(["claim of the paper", f"holds, `{OURS}`", f"holds, `{PAPER_SETUP}`"], records)


def _tables(rows: Sequence[Row]) -> list[Values]:
    """Returns the measured tables, one for each ego and set of roads, each with the last horizon of ADE as `LAST`."""
    tables: dict[tuple[str, str], dict[str, dict[str, float]]] = {}
    for row in rows:
        if row.set not in (PUBLISHED, ALL_SETS) and row.ego != CONFLICTING_EGOS:
            tables.setdefault((row.ego, row.set), {}).setdefault(row.measure, {})[row.method] = float(row.value)
    for table in tables.values():
        told = [table[f"ade_{h}"] for h in HORIZONS_S if f"ade_{h}" in table]
        table[LAST] = told[-1] if told else {}
    return list(tables.values())


def _count(claim: Claim, tables: Sequence[Values], ours: str) -> str:
    """Returns `HELD of TOLD` tables; `-` where none tells, or none has the row `ours`."""
    with_ours = [table for table in tables if any(ours in by_method for by_method in table.values())]
    answers = [answer for table in with_ours if (answer := claim.holds(table, ours)) is not None]
    return f"{sum(answers)} of {len(answers)}" if answers else NOTHING
