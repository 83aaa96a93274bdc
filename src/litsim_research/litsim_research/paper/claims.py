"""What the paper says of its results in words, and in how many of our tables each claim holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from litsim_eval.analysis.measures.displacement import HORIZONS_S
from litsim_research.paper.experiments import DRIVEN_BY_BASELINES, OURS, PAPER_SETUP
from litsim_research.paper.tables import ALL_SETS, CONFLICTING_EGOS, NOTHING, PUBLISHED, ClaimRow, Row, markdown
from litsim_sim.scenario.policies import REPLAY

Values = Mapping[str, Mapping[str, float]]
"""A table with one ego on one set of roads: values by measure, then by method."""
Holds = Callable[[Values, str], bool | None]

RIVALS = DRIVEN_BY_BASELINES
EVERYBODY = (REPLAY, *RIVALS)
SHORT_S = 15  # [s] up to which the paper calls a simulation short
SHORT, LONG = (tuple(f"ade_{h}" for h in HORIZONS_S if (h <= SHORT_S) == short) for short in (True, False))
LAST = "ade_last"
"""Key of ADE at the last horizon that a table has."""


@dataclass(frozen=True)
class Claim:
    """A claim, and whether it holds in a table.

    Attributes:
        text: the claim.
        holds: the answer for a table, given the name of the row that is LitSim; None where the table does not tell.
    """

    text: str
    holds: Holds


def _better(measures: Sequence[str], method: str, than: Sequence[str], *, most: bool = False) -> Holds:
    """Returns the question whether `method` is better than others in each of those `measures` that a table has.

    Methods are names of rows, `OURS` for the one that is LitSim; higher values are better if `most`.
    """

    def holds(table: Values, ours: str) -> bool | None:
        def value(measure: str, name: str) -> float | None:
            return table.get(measure, {}).get(ours if name == OURS else name)

        pairs = [(value(m, method), value(m, other)) for m in measures for other in than]
        told = [(own, other) for own, other in pairs if own is not None and other is not None]
        return all(own > other if most else own < other for own, other in told) if told else None

    return holds


CLAIMS = (
    Claim("up to 15 s, IDM is nearest to the log", _better(SHORT, "idm", (OURS, "gail", "simnet"))),
    Claim("beyond 15 s, LitSim is nearest to the log", _better(LONG, OURS, RIVALS)),
    Claim("LitSim has the lowest collision rate", _better(("collision_beyond",), OURS, EVERYBODY)),
    Claim("LitSim has the highest reactivity", _better(("reactivity_beyond",), OURS, EVERYBODY, most=True)),
    Claim("LitSim has fewest contacts at the background's fault", _better(("fault_background",), OURS, EVERYBODY)),
    Claim("LitSim has fewest contacts at the ego's fault", _better(("fault_ego",), OURS, EVERYBODY)),
    Claim("LitSim has the lowest relevant ratio, apart from replay", _better(("relevant",), OURS, RIVALS)),
    Claim("of IDM, GAIL and SimNet, SimNet collides least", _better(("collision_beyond",), "simnet", ("idm", "gail"))),
    Claim("GAIL makes most progress", _better(("progress",), "gail", (OURS, "idm", "simnet"), most=True)),
)
"""Of Table II; LitSim is compared with each baseline in both of its rows, and with replay where that is not perfect by
definition."""

ABLATION_CLAIMS = (
    Claim("joint forecasts bring agents nearer to the log (M1, M0)", _better((LAST,), "M1", ("M0",))),
    Claim("joint forecasts avoid collisions (M1, M0)", _better(("collision_beyond",), "M1", ("M0",))),
    Claim("policy C brings agents nearer to the log (M2, M1)", _better((LAST,), "M2", ("M1",))),
    Claim("policy C avoids collisions (M2, M1)", _better(("collision_beyond",), "M2", ("M1",))),
    Claim("the larger ROI brings agents nearer to the log (M\\*, M2)", _better((LAST,), PAPER_SETUP, ("M2",))),
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
