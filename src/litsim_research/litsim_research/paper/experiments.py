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

BASELINES = ("idm", "gail", "rail", "simnet", "rollout")
"""Policies of :mod:`litsim_research.baselines`, in the order of the tables."""
OURS = "litsim"
PAPER_SETUP = "paper"
PAPER_EGO = "bat"
CONFLICTING = (
    EgoSetup(
        name="brake",
        kind="perturbed",
        parameters={"ego.kind": "brake", "ego.deceleration": 4.0, "ego.duration": 4.0},
    ),
    EgoSetup(name="lane_change", kind="perturbed", parameters={"ego.kind": "lane_change"}),
)
"""Egos that leave their logs so that replayed traffic runs into them, which it hardly ever does with the paper's."""
EGOS = (*CONFLICTING, EgoSetup(name=PAPER_EGO, kind=PAPER_EGO))
JUDGED = Criteria.model_validate({"runs": [{"name": "reactive", "field": "reactive", "equals": True}]})

Policy = str | PolicySetup


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


def in_conflict(baseline: str) -> str:
    """Returns the name of the row in which a baseline drives the agents that LitSim would take over."""
    return f"{baseline}, conflict"


IN_CONFLICT: Mapping[str, Any] = {"conflict.baselines": "conflict", "predictor.forecast_all": True}
DRIVEN_BY_BASELINES = tuple(name for base in BASELINES for name in (base, in_conflict(base)))
"""Rows of the baselines: each drives everybody near the ego, or the agents that LitSim would take over."""


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
        egos: drivers of the ego.
        by_set: whether there is a table for each ego on each set of roads, beside that of all of them together.
        aimed: whether the goals are reported.
        counts_alone: whether its short table has contacts, takeovers and hard brakes only.
        published: the paper's figures, shown below the runs.
    """

    name: str
    description: str
    policies: tuple[Policy, ...]
    egos: tuple[EgoSetup, ...]
    by_set: bool = True
    aimed: bool = False
    counts_alone: bool = False
    published: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def suite(self, sets: tuple[str, ...], egos: tuple[EgoSetup, ...], folder: Path, *, quick: bool) -> Suite:
        """Returns the campaign on the `sets` of roads with `egos`; scenarios generated for it go to `folder`.

        Raises:
            InputError: see :func:`.roads.roads`.
        """
        cases = roads(sets, folder, quick=quick)
        return Suite(
            name=self.name,
            description=self.description,
            cases=[entry for entries in cases.values() for entry in entries],
            egos=list(egos),
            policies=list(self.policies),
            criteria=JUDGED,
        )


TABLE = Experiment(
    name="table",
    description="Table II: pure replay, the baselines, ours, and ours as the paper configures it.",
    policies=(
        REPLAY,
        *(
            row
            for base in BASELINES
            for row in (base, PolicySetup(name=in_conflict(base), kind=base, parameters=dict(IN_CONFLICT)))
        ),
        OURS,
        PAPER_SETUP,
    ),
    egos=EGOS,
    aimed=True,
    published=published.TABLE,
)
ABLATIONS = Experiment(
    name="ablation",
    description="M0, M1, M2 and M* of the ablation study, as the paper configures them, replay, and ours.",
    policies=(REPLAY, *ABLATION),
    egos=CONFLICTING,
    published=published.ABLATION,
)
CHANGED = Experiment(
    name="changes",
    description="Ours with one of its changes at a time taken back to what the paper does.",
    policies=(REPLAY, OURS, *_taken_back(), PAPER_SETUP),
    egos=CONFLICTING[:1],
    by_set=False,
    counts_alone=True,
)
EXPERIMENTS = {experiment.name: experiment for experiment in (TABLE, ABLATIONS, CHANGED)}
