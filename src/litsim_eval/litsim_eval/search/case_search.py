"""The search in one case: its runs with changes, and the margin that they give."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from litsim_eval.campaign.case import Case
from litsim_eval.campaign.results import RunResult, rerun_command
from litsim_eval.campaign.suite import CaseEntry
from litsim_eval.search.explore import Exploration, Tried
from litsim_eval.search.judging import Outcome, closeness, first_contacts, missed_by, outcome_of
from litsim_eval.search.margins import CriticalChange, Margin
from litsim_eval.search.people import People
from litsim_eval.search.space import Proposal, Space
from litsim_sim.record.run import Run
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario


@dataclass
class CaseSearch:
    """The search in one case of a suite; of its runs, by number, the entry of a suite, the case and the result.

    Runs whose scenario cannot be loaded, such as one with an agent that would enter before the recording begins, have
    a result alone.
    """

    case: Case
    exploration: Exploration
    entries: dict[int, CaseEntry] = field(default_factory=dict)
    cases: dict[int, Case] = field(default_factory=dict)
    results: dict[int, RunResult] = field(default_factory=dict)

    @classmethod
    def of(cls, case: Case, people: People, only: tuple[str, ...]) -> CaseSearch:
        """Returns the search in a case within what `people` do, of which `only` some may vary; none for all."""
        scenario = Scenario.load(case.scenario).around(case.ego_id, case.seed, case.end_after_contact_s, case.draw)
        return cls(case, Exploration(Space.of(scenario, people, only)))

    def place(self, run: Run, people: People, only: tuple[str, ...]) -> None:
        """Lets agents act where they and the ego are in the `run` without changes, not where they were recorded."""
        driven = Log.from_rows(run.steps.stacked, len(run.steps))
        self.exploration.space = Space.of(self.exploration.space.scenario, people, only, driven)

    @property
    def failed_cases(self) -> list[Case]:
        """The cases of the failures that are shown."""
        return [self.cases[failure.number] for failure in self.exploration.failures]

    def scenario_name(self, number: int) -> str:
        """Returns the name of the scenario of a run."""
        seed = "" if self.case.seed is None else f"_s{self.case.seed}"
        return f"{Path(self.case.scenario).stem}_{self.case.ego_id}{seed}_{number:04d}"

    def tried(self, number: int, how: str, proposal: Proposal) -> Tried:
        """Returns what became of a proposal."""
        result, distance = self.results[number], round(self.exploration.space.distance(proposal), 4)
        outcome = outcome_of(result, self.exploration.space.scenario.history_steps)
        group = missed_by(result) if outcome == Outcome.FAILED else ""
        return Tried(number, how, proposal, distance, outcome, group, closeness(result.metrics))

    def margin(self, folder: Path, repeated: Mapping[str, RunResult]) -> Margin:
        """Returns what the search has come to.

        Args:
            folder: of the campaign of its runs.
            repeated: results of the failures, run once more, by id of the case.
        """
        tried, failures = self.exploration.tried, self.exploration.failures
        count = {outcome: sum(run.outcome == outcome for run in tried) for outcome in Outcome}
        judged = [run for run in tried[1:] if run.outcome != Outcome.ERROR]
        drawn = [run for run in judged if run.how == "drawn"]
        bad = sum(run.outcome == Outcome.FAILED for run in drawn)
        unchanged = (self.results[0].metrics or {}).get("digest")
        acted = [run for run in judged if (self.results[run.number].metrics or {}).get("digest") != unchanged]
        bounds = binomtest(bad, len(drawn)).proportion_ci(0.95, "exact") if drawn else None
        return Margin(
            name=self.case.name,
            margin=failures[0].distance if failures else None,
            recorded=tried[0].outcome,
            reason=self.results[0].reason,
            runs=len(tried),
            failed=count[Outcome.FAILED],
            forced=count[Outcome.FORCED],
            errors=count[Outcome.ERROR],
            tries=dict(Counter(run.proposal.act for run in acted).most_common()),
            drawn=len(drawn),
            drawn_failed=bad,
            rate=None if bounds is None else (round(float(bounds.low), 4), round(float(bounds.high), 4)),
            failures=[self._critical(failure, repeated[self.cases[failure.number].id], folder) for failure in failures],
        )

    def row(self, tried: Tried) -> dict[str, Any]:
        """Returns a run as a row of the table: what it was, its changes in their units, and their distances."""
        space, proposal, result = self.exploration.space, tried.proposal, self.results[tried.number]
        distances = {f"distance.{name}": round(z, 4) for name, z in space.distances(proposal).items()}
        return {
            "case": self.case.name,
            "scenario": self.scenario_name(tried.number),
            "number": tried.number,
            "how": tried.how,
            "distance": tried.distance,
            "reason": result.reason,
            "digest": (result.metrics or {}).get("digest") or "",
            "outcome": tried.outcome.value,
            "act": proposal.act,
            "agent": proposal.agent,
            "begin_s": proposal.begin_s,
            **space.values(proposal),
            **distances,
        }

    def _critical(self, tried: Tried, again: RunResult, folder: Path) -> CriticalChange:
        """Returns a failure, which has been run `again`, as it is shown."""
        space, result = self.exploration.space, self.results[tried.number]
        metrics = result.metrics or {}
        first = first_contacts(metrics)[:1]
        return CriticalChange(
            name=self.scenario_name(tried.number),
            act=tried.proposal.act,
            distance=tried.distance,
            distances={name: round(z, 3) for name, z in space.distances(tried.proposal).items()},
            changes=[change.text for change in space.changes(tried.proposal)] or ["as recorded"],
            reason=result.reason,
            holds=outcome_of(again, space.scenario.history_steps) == Outcome.FAILED and missed_by(again) == tried.group,
            careful_driver=first[0]["avoided"] if first else None,
            digest=metrics["digest"],
            rerun=rerun_command(folder, self.cases[tried.number]),
        )
