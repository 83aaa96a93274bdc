"""`evaluate`: many egos, several policies, one table."""

from __future__ import annotations

import argparse
import json
import sys
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_policy.run.evaluation import Job, run_batch, summarise
from litsim_policy.run.runner import configured
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import SET_HELP, by_stage, setting
from litsim_sim.core.stages import POLICY_STAGES
from litsim_sim.scenario.run_info import EGOS, POLICIES
from litsim_sim.scenario.scenario import Scenario

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
    "takeovers per run": "takeovers_per_run",
    "of them released": "releases",
    "time under control s": "held_s",
    "bound of iterations hit": "bound_hits",
    "false alarms": "false_alarms",
    "relevant %": "relevant_ratio",
    "hard brakes of controlled": "hard_brakes",
    "guarded %, of policy C's steps": "guarded",
    "off road %, controlled": "off_road",
    "progress m": "progress_m",
    "max jump m": "max_position_jump_m",
    "max residual at release m": "max_residual_m",
}
PERCENT = ("rate_all", "rate_controlled", "reactive", "relevant_ratio", "guarded", "off_road")


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_policy evaluate``."""
    p = argparse.ArgumentParser(
        prog="evaluate", description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    p.add_argument("--scenario", nargs="+", default=["demo"], help="names of packaged scenarios, or YAML files")
    p.add_argument("--ego", default="idm", choices=[e for e in EGOS if e != "external"], help="what drives the ego")
    p.add_argument("--policy", nargs="+", default=["replay", "litsim"], choices=POLICIES, help="rows of the table")
    p.add_argument("--predictor", nargs="+", metavar="MODEL", help="a row for each model that forecasts")
    p.add_argument(
        "--set",
        type=setting,
        nargs="+",
        default=[],
        metavar="STAGE.NAME=VALUE[,VALUE]",
        help=f"{SET_HELP}; a row for each of several values",
    )
    p.add_argument("--egos", default="egos", help="field of the scenarios (egos, tuning, ego), all, or ids with commas")
    p.add_argument("--seeds", nargs="+", type=int, help="a run for each seed and ego, instead of the scenario's seed")
    p.add_argument("--graph", action="store_true", help="run each over DDS instead of in process")
    p.add_argument("--out", default="bags/evaluation", help="folder of the results, and of recordings over DDS")
    p.add_argument("--processes", type=_at_least_one, default=2, help="runs at a time, in process")
    return p


def evaluate(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run what the arguments ask for; returns the summary by row of the table, and the metrics of every run."""
    egos = [(name, ego) for name in arguments.scenario for ego in _egos(arguments.egos, Scenario.load(name))]
    names = [Path(name).stem for name in arguments.scenario]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise InputError(f"--scenario: {', '.join(twice)} more than once; runs are told apart by the name of the file")
    rows = _rows(arguments)
    for row in rows:  # what is wrong with a parameter is to be known before the first run
        configured(arguments.ego, row["policy"], by_stage(row["parameters"]))
    draws = product(rows, arguments.seeds or [None], egos)
    jobs = [Job(name, arguments.ego, ego_id=ego, seed=seed, **row) for row, seed, (name, ego) in draws]
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    with tqdm(total=len(jobs), unit="run", dynamic_ncols=True) as bar:
        found = run_batch(jobs, arguments.processes, out if arguments.graph else None, bar.update)
    runs: dict[str, dict[str, Any]] = {}
    for job in jobs:
        runs.setdefault(job.row, {})[job.name] = found[job]
    return {"summary": {row: summarise(mine.values()) for row, mine in runs.items()}, "runs": runs}


def _rows(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Policy, parameters and label of each row: every policy with every combination of what is varied."""
    varied = [("predictor", "model", arguments.predictor or []), *arguments.set]
    rows = []
    for policy in arguments.policy:
        # a replay has no stages of the policy; of others, what is unknown is to be refused
        mine = [s for s in varied if s[2] and (policy != "replay" or s[0] not in POLICY_STAGES)]
        for values in product(*(values for _, _, values in mine)):
            parameters = tuple((stage, name, value) for (stage, name, _), value in zip(mine, values, strict=True))
            told = [
                str(value) if name == "model" else f"{name}={value}"
                for (_, name, several), value in zip(mine, values, strict=True)
                if len(several) > 1 or name == "model"
            ]
            rows.append({"policy": policy, "parameters": parameters, "label": ", ".join(told)})
    return rows


def print_table(title: str, summary: dict[str, dict[str, Any]]) -> None:
    """Print `summary`, measures by row of the table, with the policies side by side."""
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


def _at_least_one(text: str) -> int:
    """A number of processes from the text of an option.

    Raises:
        argparse.ArgumentTypeError: the text is no such number.
    """
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a whole number of at least 1")
    return int(text)


def _egos(choice: str, scenario: Scenario) -> tuple[int, ...]:
    if choice == "ego":
        return (scenario.ego_id,)
    if choice == "all":
        return scenario.possible_egos
    if choice in ("egos", "tuning"):
        chosen = scenario.egos if choice == "egos" else scenario.tuning_egos
        if not chosen:
            raise InputError(f"{scenario.name}: field {choice} of the scenario lists no egos")
        return chosen
    try:
        chosen = tuple(int(part) for part in choice.split(","))
    except ValueError as error:
        raise InputError(f"--egos {choice}: expected egos, tuning, ego, all, or ids with commas") from error
    absent = sorted(set(chosen) - set(scenario.possible_egos))
    if absent:
        named = ", ".join(map(str, absent))
        raise InputError(
            f"--egos {choice}: {named} not there at the start of {scenario.name}, expected vehicles that are"
        )
    return chosen


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
    several = f"{len(arguments.scenario)} scenarios"
    name = arguments.scenario[0] if len(arguments.scenario) == 1 else several
    print_table(f"{name}, ego {arguments.ego}, {shell}", result["summary"])
    print(f"every run: {path}")
    if any(row["invalid"] for row in result["summary"].values()):
        sys.exit("error: some runs are not valid")


if __name__ == "__main__":
    main()
