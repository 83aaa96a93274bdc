"""Suites of the demo, their cases, and made results of them."""

from __future__ import annotations

from typing import Any

from litsim_sim.campaign.case import Case, cases_of
from litsim_sim.campaign.criteria import Criteria
from litsim_sim.campaign.suite import Suite

VERSIONS = {"python": "3", "commit": "a", "sources": "b"}
CRITERIA = Criteria(runs=[{"name": "no contact at fault", "field": "collision.ego_at_fault", "max": 0}])


def suite(**values: Any) -> Suite:
    usual: dict[str, Any] = {"name": "some", "cases": [{"scenario": "demo", "egos": "ego"}], "egos": ["idm"]}
    return Suite(**(usual | {"criteria": CRITERIA} | values))


def cases(**values: Any) -> list[Case]:
    return cases_of(suite(**values), with_versions=VERSIONS)


def metrics(at_fault: int = 0, **values: Any) -> dict[str, Any]:
    return {"valid": True, "why": "", "collision": {"ego_at_fault": at_fault}} | values
