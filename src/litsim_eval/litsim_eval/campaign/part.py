"""Parts of a suite: cases chosen by name, tag or event, by their verdicts in a campaign, or as the hardest ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase
from os.path import relpath
from pathlib import Path
from typing import Any

import yaml

from litsim_eval.analysis.metrics import find_field, leaves
from litsim_eval.campaign.case import Case
from litsim_eval.campaign.criteria import Verdict, counted
from litsim_eval.campaign.results import Campaign
from litsim_eval.campaign.suite import CaseEntry, Suite, packaged_suite_folder
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import write_text

SMALL_IS_HARD = ("ttc", "pet", "headway", "gap", "progress", "within")
"""Parts of names of fields whose smallest values are the hardest; of all others, the largest are."""


@dataclass(frozen=True)
class Part:
    """What chooses cases of a suite; a case is chosen if all that is not empty or None does.

    Attributes:
        names: names of cases, their beginnings up to a slash, or shell patterns of names; one has to fit.
        tags: one of which the case has.
        events: kinds of events, one of which happens.
        failed_in: a campaign in which the case has not passed: the case of the same name there, or if there is none,
            any of its vehicle.
        hardest: how many cases, and the field by which they are the hardest: of their events, or of `metrics.json` in
            `measured_in`.
        measured_in: campaign with the measures of the cases.
    """

    names: Sequence[str] = ()
    tags: Sequence[str] = ()
    events: Sequence[str] = ()
    failed_in: Campaign | None = None
    hardest: tuple[int, str] | None = None
    measured_in: Campaign | None = None

    def of(self, cases: Sequence[Case]) -> list[Case]:
        """Returns the chosen ones of `cases`, in their order; the hardest ones first.

        Raises:
            InputError: an option chooses none, or the field is not known.
        """
        part = list(cases)
        for name in self.names:
            if not any(_is_called(case, name) for case in part):
                names = [case.name for case in cases]
                near = get_close_matches(name, names, n=3, cutoff=0.4) or names[:2]
                raise InputError(f"--case {name}: no such case, expected names such as {', '.join(near)}")
        if self.names:
            part = [case for case in part if any(_is_called(case, name) for name in self.names)]
        if self.tags:
            tags = sorted({tag for case in part for tag in case.tags})
            part = [case for case in part if set(self.tags) & set(case.tags)]
            _check(part, f"--tag {' '.join(self.tags)}", f"some of {', '.join(tags) or 'no tags'}")
        if self.events:
            kinds = sorted({str(event["kind"]) for case in part for event in case.events})
            part = [case for case in part if any(event["kind"] in self.events for event in case.events)]
            _check(part, f"--event {' '.join(self.events)}", f"some of {', '.join(kinds) or 'no events'}")
        if self.failed_in is not None:
            part = _failed(part, self.failed_in)
            _check(part, f"--failed-in {self.failed_in.folder}", "a campaign in which one has not passed")
        if self.hardest is not None:
            part = self._hardest(part, *self.hardest)
        return part

    def _hardest(self, cases: list[Case], count: int, field: str) -> list[Case]:
        values = {case.id: _value(case, field, self.measured_in) for case in cases}
        measured = [case for case in cases if values[case.id] is not None]
        if not measured:
            if self.measured_in is not None:
                find_field(field)
            fields = sorted({str(name) for case in cases for event in case.events for name in event} - {"kind"})
            raise InputError(
                f"--hardest {count} {field}: no case has this field, expected one of its events "
                f"({', '.join(fields) or 'none'}), or of metrics.json with a campaign as --suite or --failed-in"
            )
        return sorted(measured, key=lambda case: values[case.id] or 0.0, reverse=not _is_small_hard(field))[:count]


def suite_of_cases(suite: Suite, cases: Sequence[Case]) -> Suite:
    """Returns the `suite` with an entry for each vehicle of `cases`, and without egos and policies that none has.

    Every one of its entries is run with all its egos, policies and parameters, which may be more than `cases`.
    """
    entries: dict[tuple[Any, ...], CaseEntry] = {}
    for case in cases:
        seed = None if suite.seeds else case.seed
        entry = CaseEntry(
            scenario=case.scenario,
            ego_id=case.ego_id,
            seed=seed,
            tags=list(case.tags),
            events=[dict(event) for event in case.events],
        )
        entries.setdefault((case.scenario, case.ego_id, seed), entry)
    drivers, policies = {case.ego.name for case in cases}, {case.policy for case in cases}
    return suite.model_copy(
        update={
            "cases": list(entries.values()),
            "egos": [ego for ego in suite.egos if ego.name in drivers],
            "policies": [
                policy for policy, setup in zip(suite.policies, suite.setups, strict=True) if setup.kind in policies
            ],
        }
    )


def write_suite(suite: Suite, path: Path) -> None:
    """Writes a suite to `path`, with paths relative to it; raises Unwritable if that is impossible."""
    values = suite.model_dump(mode="json", exclude_defaults=True)
    values["criteria"] = suite.criteria.model_dump(mode="json", exclude_defaults=True)
    for entry in values["cases"]:
        entry["scenario"] = _beside(entry["scenario"], path.parent)
    for ego in values["egos"]:
        if "folder" in ego:
            ego["folder"] = _beside(ego["folder"], path.parent)
    write_text(path, yaml.safe_dump(values, sort_keys=False, width=120))


def _beside(path: str, folder: Path) -> str:
    """Returns an absolute path as it is found from `folder`; names of packaged scenarios stay as they are."""
    if not Path(path).is_absolute():
        return path
    within = packaged_suite_folder().resolve()
    return relpath(path, within if Path(path).is_relative_to(within) else folder.resolve())


def _is_called(case: Case, name: str) -> bool:
    return case.name.startswith(f"{name.rstrip('/')}/") or case.name == name or fnmatchcase(case.name, name)


def _failed(cases: Sequence[Case], campaign: Campaign) -> list[Case]:
    results = {result.case.name: result for result in campaign.results}
    bad = [result for result in campaign.results if result.verdict != Verdict.PASSED]
    names, vehicles = {result.case.name for result in bad}, {_vehicle(result.case) for result in bad}
    return [case for case in cases if (case.name in names if case.name in results else _vehicle(case) in vehicles)]


def _vehicle(case: Case) -> tuple[str, int]:
    return Path(case.scenario).stem, case.ego_id


def _value(case: Case, field: str, campaign: Campaign | None) -> float | None:
    """Returns the value of a field for a case, the hardest if there are several; None if it has none."""
    values = [event.get(field) for event in case.events]
    if campaign is not None:
        results = [result for result in campaign.results if result.case.name == case.name]
        results = results or [result for result in campaign.results if _vehicle(result.case) == _vehicle(case)]
        values += [counted(leaves(result.metrics or {}).get(field)) for result in results]
    numbers = [float(value) for value in values if isinstance(value, int | float)]
    return (min if _is_small_hard(field) else max)(numbers, default=None)


def _is_small_hard(field: str) -> bool:
    return any(part in field for part in SMALL_IS_HARD)


def _check(cases: Sequence[Case], option: str, expected: str) -> None:
    if not cases:
        raise InputError(f"{option}: no case is left, expected {expected}")
