"""The runs that each of the paper's experiments consists of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.suite import EgoSetup, Suite
from litsim_research.paper import published
from litsim_research.paper.roads import roads
from litsim_sim.scenario.policies import REPLAY, PolicySetup, setup_of

BASELINES = ("idm", "gail", "rail", "simnet")
"""Policies of :mod:`litsim_research.baselines`, in the order of the paper's tables."""
OURS = "litsim"
PAPER_SETUP = "paper"
PAPER_EGO = "bat"
EGOS = (PAPER_EGO, "idm", "perturbed")
DEVIATING_EGO = EgoSetup(name="bat_sampled", kind=PAPER_EGO, parameters={"ego.maneuver": "sampled"})
"""The paper's ego where it does what it thinks possible, and not only what is most probable."""
JUDGED = Criteria.model_validate({"runs": [{"name": "reactive", "field": "reactive", "equals": True}]})

Policy = str | PolicySetup


def _row(name: str, kind: str, **parameters: Any) -> PolicySetup:
    return PolicySetup(name=name, kind=kind, parameters={k.replace("__", "."): v for k, v in parameters.items()})


def _of_paper(name: str, kind: str = OURS, parameters: Mapping[str, Any] | None = None) -> PolicySetup:
    """Returns the paper's configuration with a ROI of 15 m and other `parameters`; only `OURS` reads its policy's."""
    paper = setup_of(PAPER_SETUP).parameters
    inherited = {key: value for key, value in paper.items() if kind == OURS or not key.startswith("policy.")}
    small = {"predictor.roi_m": 15.0, "conflict.roi_m": 15.0}
    return PolicySetup(name=name, kind=kind, parameters={**inherited, **small, **(parameters or {})})


ABLATION: tuple[Policy, ...] = (
    _of_paper("M0", "yield", {"predictor.model": "kinematic"}),
    _of_paper("M1", "yield"),
    _of_paper("M2"),
    PAPER_SETUP,
    OURS,
)
"""The paper's ablation, in its configuration: kinematic instead of joint prediction, rules instead of policy C; M* is
`PAPER_SETUP`."""


IN_REGION: dict[str, dict[str, Any]] = {
    "{}": {},
    "{}, conflict": {"conflict__baselines": "conflict", "predictor__forecast_all": True},
    "{}, all": {"conflict__baselines": "all"},
}
"""Parameters by the row of a baseline: everybody near the ego, the agents that LitSim would take over, everybody."""


CHANGES = {
    "its predictor": ("predictor.model", "predictor.modes", "predictor.along_lanes"),
    "its horizon": ("conflict.horizon",),
    "mean forecasts": (
        "conflict.sigma_scale",
        "conflict.braking_time",
        "conflict.closing_time",
        "conflict.planned_motion",
    ),
    "ROI around the ego": ("conflict.region", "conflict.approach_time"),
    "no confirmation": ("conflict.confirm_steps", "conflict.held_steps_min", "conflict.clear_steps"),
    "no passing": ("conflict.passing",),
    "its hand-back": ("conflict.handback",),
    "overlaps alone": ("conflict.unlikely",),
    "its policy C": ("policy.weights",),
    "no car following": ("policy.drivers",),
    "no rules": ("policy.rules",),
    "no guard": ("policy.safety.contact",),
}
"""Parameters in which LitSim differs from the paper, by the name of the row that reverts them."""


def _taken_back() -> list[PolicySetup]:
    """Returns LitSim with one change at a time reverted to the paper."""
    paper = setup_of(PAPER_SETUP).parameters
    return [
        PolicySetup(name=name, kind=OURS, parameters={parameter: paper[parameter] for parameter in names})
        for name, names in CHANGES.items()
    ]


@dataclass(frozen=True)
class Experiment:
    """The runs behind one table.

    Attributes:
        name: name of the command and of the campaign's folder.
        description: the question that it answers.
        policies: the rows.
        egos: drivers of the ego, with a table each.
        own_egos: whether other egos cannot be requested.
        by_set: whether each set of roads has its own tables; otherwise they cover all sets together.
        aimed: whether the goals are reported.
        counts_alone: whether its short table has contacts, takeovers and hard brakes only.
        short_egos: those of `egos` that its short table has, if they were run; empty: all.
        published: the paper's figures, shown with the runs of its ego.
    """

    name: str
    description: str
    policies: tuple[Policy, ...]
    egos: tuple[str, ...]
    own_egos: bool = False
    by_set: bool = True
    aimed: bool = False
    counts_alone: bool = False
    short_egos: tuple[str, ...] = ()
    published: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def suite(self, sets: tuple[str, ...], egos: tuple[str, ...], folder: Path, *, quick: bool) -> Suite:
        """Returns the campaign on the `sets` of roads with `egos`; scenarios generated for it go to `folder`.

        Raises:
            InputError: see :func:`.roads.roads`.
        """
        cases = roads(sets, folder, quick=quick)
        return Suite(
            name=self.name,
            description=self.description,
            cases=[entry for entries in cases.values() for entry in entries],
            egos=[DEVIATING_EGO if ego == DEVIATING_EGO.name else EgoSetup(name=ego, kind=ego) for ego in egos],
            policies=list(self.policies),
            criteria=JUDGED,
        )


TABLE = Experiment(
    name="table",
    description="Table II: pure replay, the baselines, ours, and ours as the paper configures it.",
    policies=(REPLAY, *BASELINES, OURS, PAPER_SETUP),
    egos=EGOS,
    aimed=True,
    short_egos=EGOS[:2],
    published=published.TABLE,
)
ABLATIONS = Experiment(
    name="ablation",
    description="M0, M1, M2 and M* of the ablation study, as the paper configures them, and ours.",
    policies=ABLATION,
    egos=EGOS,
    published=published.ABLATION,
)
CHANGED = Experiment(
    name="changes",
    description="Ours with one of its changes at a time taken back to what the paper does.",
    policies=(OURS, *_taken_back(), PAPER_SETUP),
    egos=EGOS[1:],
    by_set=False,
)
"""Without the paper's ego, which causes hardly any takeovers, so that changes would have no effect."""

REGIONS = Experiment(
    name="regions",
    description="Each baseline, driving everybody near the ego, whom LitSim would take over, or everybody.",
    policies=(
        REPLAY,
        *(_row(name.format(base), base, **chosen) for base in BASELINES for name, chosen in IN_REGION.items()),
        OURS,
    ),
    egos=("idm",),
    own_egos=True,
    counts_alone=True,
)
DEVIATING = Experiment(
    name="deviating",
    description="The paper's ego with sampled manoeuvres, which lead it away from its log.",
    policies=(REPLAY, "idm", OURS, PAPER_SETUP),
    egos=(DEVIATING_EGO.name,),
    own_egos=True,
    counts_alone=True,
)
EXPERIMENTS = {experiment.name: experiment for experiment in (TABLE, ABLATIONS, CHANGED, REGIONS, DEVIATING)}
