"""Suites of the demo, their cases, and made results of them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import yaml

from litsim_sim.campaign.case import Case, cases_of
from litsim_sim.campaign.criteria import Criteria
from litsim_sim.campaign.results import read_campaign
from litsim_sim.campaign.suite import Suite
from litsim_sim.report.experiment import write_experiment_report
from litsim_sim.scenario.scenario import packaged

VERSIONS = {"python": "3", "commit": "a", "sources": "b"}
CRITERIA = Criteria(runs=[{"name": "no contact at fault", "field": "collision.ego_at_fault", "max": 0}])


def suite(**values: Any) -> Suite:
    usual: dict[str, Any] = {"name": "some", "cases": [{"scenario": "demo", "egos": "ego"}], "egos": ["idm"]}
    return Suite(**(usual | {"criteria": CRITERIA} | values))


def cases(**values: Any) -> list[Case]:
    return cases_of(suite(**values), with_versions=VERSIONS)


def metrics(at_fault: int = 0, **values: Any) -> dict[str, Any]:
    return {"valid": True, "why": "", "collision": {"ego_at_fault": at_fault}} | values


def scenario_file(folder: Path, name: str = "own", **values: Any) -> str:
    """Copy the demo with its recording beside it; return the path of its file."""
    folder.mkdir(parents=True, exist_ok=True)
    demo = yaml.safe_load(packaged("scenarios/demo.yaml").read_text())
    shutil.copy(packaged(f"scenarios/{demo['recording']}"), folder / "demo.parquet")
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(demo | {"recording": "demo.parquet"} | values))
    return str(path)


def told(out: Path) -> list[Any]:
    """All results of the campaign in `out`, without wall times and dates."""
    found = []
    for result in read_campaign(out).results:
        plain = result.to_json() | {"wall_s": 0, "finished_at": ""}
        plain["metrics"] = plain["metrics"] | {"timing": {}}
        found.append(plain)
    return found


def page_of(folder: Path, out: Path | None = None) -> Path:
    """The page of the campaign in `folder`, written."""
    return write_experiment_report(read_campaign(folder), out)
