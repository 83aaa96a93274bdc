"""Suites of the demo, their cases, and made results of them."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from litsim_eval.campaign.case import Case, cases_of
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import Campaign, RunResult, read_campaign
from litsim_eval.campaign.suite import Suite
from litsim_eval.report.experiment import write_experiment_report
from litsim_sim.scenario.scenario import packaged

DEMO: dict[str, Any] = yaml.safe_load(packaged("scenarios/demo.yaml").read_text())
EGO: int = DEMO["ego"]
EGOS: list[int] = DEMO["egos"]
VERSIONS = {"python": "3", "commit": "a", "sources": "b"}
CRITERIA = Criteria(runs=[{"name": "no contact at fault", "field": "collision.ego_at_fault", "max": 0}])


def suite(**values: Any) -> Suite:
    usual: dict[str, Any] = {"name": "some", "cases": [{"scenario": "demo", "ego_id": "ego"}], "egos": ["idm"]}
    return Suite(**(usual | {"criteria": CRITERIA} | values))


def cases(**values: Any) -> list[Case]:
    return cases_of(suite(**values), with_versions=VERSIONS)


def metrics(at_fault: int = 0, **values: Any) -> dict[str, Any]:
    """Metrics of a run with that many contacts at the ego's fault, and other `values`."""
    collision = {"ego_at_fault": at_fault} | values.get("collision", {})
    return summarised_metrics(**({"why": ""} | values | {"collision": collision}))


def summarised_metrics(**changes: Any) -> dict[str, Any]:
    """Metrics of a run as `compute_metrics` would give them, as far as `summarise` reads them."""
    usual: dict[str, Any] = {
        "valid": True,
        "steps": 280,
        "agents": 10,
        "reactive": True,
        "takeovers": 2,
        "ledger": [
            {"detected_step": 50, "released_step": 80, "held_s": 3.0, "outcome": "back_on_log"},
            {"detected_step": 200, "released_step": None, "held_s": 3.5, "outcome": None},
            {"detected_step": 260, "released_step": None, "held_s": 2.0, "outcome": "outlived_log"},
        ],
        "detection": {"bound_hits": 1, "max_iterations": 3},
        "false_alarms": 1,
        "comfort": {
            "controlled": {
                "hard_brakes": 4,
                "hard_brakes_log": 3,
                "guarded": {"count": 5, "commands": 50, "share": 0.1},
            }
        },
        "off_road_controlled": 0.1,
        "relevant_ratio": 0.2,
        "ade_controlled_m": {"5": 1.0},
        "ade_all_m": {"5": 0.5},
        "replay_error_max_m": 0.0,
        "progress_m": 100.0,
        "collision": {
            "agents": 0,
            "excess": 0,
            "contacts": [],
            "ego_contacts": [],
            "by_fault": {"background": 0, "ego_avoidable": 0, "ego_unavoidable": 0},
            "rate_all": 0.0,
            "rate_controlled": 0.0,
        },
        "handback": {"max_position_jump_m": 0.01, "max_residual_m": 0.4},
        "timing": {"realtime_factor": 20.0},
    }
    for name, value in changes.items():
        usual[name] = {**usual.get(name, {}), **value} if isinstance(value, dict) else value
    return usual


def scenario_file(folder: Path, name: str = "own", **values: Any) -> str:
    """Copy the demo with its recording beside it; return the path of its file."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(packaged(f"scenarios/{DEMO['recording']}"), folder)
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(DEMO | values))
    return str(path)


def stored(
    folder: Path,
    outcomes: Sequence[dict[str, Any] | str | None],
    sources: str = "b",
    criteria: Criteria = CRITERIA,
    **asked: Any,
) -> Campaign:
    """A campaign with a run for each of `outcomes`: its metrics, a text for an error, None for one not run.

    The runs are of one vehicle, by seeds from 0, unless `asked` has other fields of the suite.
    """
    versions = VERSIONS | {"sources": sources}
    plan = suite(**{"policies": ["litsim"], "seeds": list(range(len(outcomes))), "criteria": criteria} | asked)
    made, writer = cases_of(plan, with_versions=versions), CampaignFolder(folder)
    writer.begin(plan, made, versions)
    for case, outcome in zip(made, outcomes, strict=True):
        if isinstance(outcome, str):
            writer.store(RunResult.error(case, outcome))
        elif outcome is not None:
            writer.store(RunResult.judged(case, outcome, criteria, report="report.html"))
    return read_campaign(folder)


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
