"""`evaluate`: many egos, several policies, one table."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_policy.evaluation import Job, run_batch, summarise
from litsim_sim.errors import InputError
from litsim_sim.run_info import EGOS, POLICIES
from litsim_sim.scenario import Scenario

COLUMNS = {
    "runs": "runs",
    "agents": "agents",
    "colliding agents": "colliding_agents",
    "colliding runs": "colliding_runs",
    "ego contacts": "ego_contacts",
    "collision %, all": "rate_all",
    "collision %, controlled": "rate_controlled",
    "reactive %": "reactive",
    "takeovers": "takeovers",
    "false alarms": "false_alarms",
    "relevant %": "relevant_ratio",
    "progress m": "progress_m",
    "max jump m": "max_position_jump_m",
}
PERCENT = ("rate_all", "rate_controlled", "reactive", "relevant_ratio")


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_policy evaluate``."""
    p = argparse.ArgumentParser(
        prog="evaluate", description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    p.add_argument("--scenario", default="demo", help="name of a packaged scenario, or a YAML file")
    p.add_argument("--ego", default="idm", choices=[e for e in EGOS if e != "external"], help="what drives the ego")
    p.add_argument("--policy", nargs="+", default=["replay", "litsim"], choices=POLICIES, help="rows of the table")
    p.add_argument("--egos", default="egos", help="field of the scenario (egos, tuning), or ids with commas")
    p.add_argument("--graph", action="store_true", help="run each over DDS instead of in process")
    p.add_argument("--out", default="bags/evaluation", help="folder of the results, and of recordings over DDS")
    p.add_argument("--processes", type=int, default=2, help="runs at a time, in process")
    return p


def evaluate(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run what the arguments ask for; returns the summary by policy, and the metrics of every run."""
    scenario = Scenario.load(arguments.scenario)
    egos = _egos(arguments.egos, scenario)
    jobs = [Job(arguments.scenario, arguments.ego, policy, ego) for policy in arguments.policy for ego in egos]
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    with tqdm(total=len(jobs), unit="run", dynamic_ncols=True) as bar:
        found = run_batch(jobs, arguments.processes, out if arguments.graph else None, bar.update)
    runs = {policy: {job.ego_id: found[job] for job in jobs if job.policy == policy} for policy in arguments.policy}
    return {"summary": {policy: summarise(by_ego.values()) for policy, by_ego in runs.items()}, "runs": runs}


def print_table(title: str, summary: dict[str, dict[str, Any]]) -> None:
    """Policies side by side."""
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for policy in summary:
        table.add_column(policy, justify="right")
    for name, key in COLUMNS.items():
        table.add_row(name, *(_cell(key, row[key]) for row in summary.values()))
    for horizon in ("5", "10", "15", "20", "25"):
        if any(row["ade_all_m"][horizon] is not None for row in summary.values()):
            both = (
                f"{_cell('', row['ade_controlled_m'][horizon])} / {_cell('', row['ade_all_m'][horizon])}"
                for row in summary.values()
            )
            table.add_row(f"ADE@{horizon} s m, controlled / all", *both)
    Console().print(table)


def _egos(choice: str, scenario: Scenario) -> tuple[int, ...]:
    if choice in ("egos", "tuning"):
        chosen = scenario.egos if choice == "egos" else scenario.tuning_egos
        if not chosen:
            raise InputError(f"{scenario.name}: field {choice} of the scenario lists no egos")
        return chosen
    try:
        return tuple(int(part) for part in choice.split(","))
    except ValueError as error:
        raise InputError(f"--egos {choice}: expected egos, tuning, or ids with commas") from error


def _cell(key: str, value: float | None) -> str:
    if value is None:
        return "-"
    if key in PERCENT:
        return f"{100.0 * value:.2f}"
    return str(value) if isinstance(value, int) else f"{value:.3g}"


def main() -> None:
    """Entry point of ``ros2 run litsim_policy evaluate``."""
    arguments = parser().parse_args()
    try:
        result = evaluate(arguments)
        path = Path(arguments.out) / "evaluation.json"
        path.write_text(json.dumps(result, indent=2) + "\n")
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    shell = "over DDS" if arguments.graph else "in process"
    print_table(f"{arguments.scenario}, ego {arguments.ego}, {shell}", result["summary"])
    print(f"every run: {path}")
    if any(row["invalid"] for row in result["summary"].values()):
        sys.exit("error: some runs are not valid")


if __name__ == "__main__":
    main()
