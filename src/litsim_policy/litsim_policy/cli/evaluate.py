"""`evaluate`: many egos, several policies, one table."""

from __future__ import annotations

import argparse
import json
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_policy.run.batch import Job, run_batch
from litsim_policy.run.runner import configured
from litsim_sim.analysis.summary import summarise
from litsim_sim.cli.arguments import DefaultsFormatter
from litsim_sim.cli.program import at_least_one, program
from litsim_sim.cli.run_arguments import add_batch_arguments
from litsim_sim.core.errors import EXIT_FAILED, InputError, print_error
from litsim_sim.core.parameters import by_stage
from litsim_sim.core.stages import POLICY_STAGES
from litsim_sim.scenario.run_info import OWN_EGOS, REPLAY
from litsim_sim.scenario.scenario import Scenario

COLUMNS = {
    "runs": "runs",
    "failed runs": "failed",
    "invalid runs": "invalid",
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
STATUS_HELP = "Exit status: 0, every run is valid; 1, some failed or are not, all listed at the end; 2, bad input."
OF_ALL_RUNS = ("runs", "failed", "invalid", "reactive")
"""Measures in which failed runs count; `reactive` is of runs known to be so."""

MARK = "*"
PERCENT = ("rate_all", "rate_controlled", "reactive", "relevant_ratio", "guarded", "off_road")


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_policy evaluate``."""
    p = argparse.ArgumentParser(
        prog="evaluate", description=__doc__, epilog=STATUS_HELP, formatter_class=DefaultsFormatter
    )
    add_batch_arguments(p, OWN_EGOS)
    p.add_argument("--egos", default="egos", help="field of the scenarios (egos, tuning, ego), all, or ids with commas")
    p.add_argument("--seeds", nargs="+", type=int, help="a run for each seed and ego, instead of the scenario's seed")
    p.add_argument("--graph", action="store_true", help="run each over DDS instead of in process")
    p.add_argument("--out", default="bags/evaluation", help="folder of the results, and of recordings over DDS")
    p.add_argument("--processes", type=at_least_one, default=2, help="runs at a time, in process")
    return p


def evaluate(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run what the arguments ask for.

    Returns:
        `summary` by row of the table; `runs`, the metrics by row and run of those that were measured; `failures`, by
        row and run why the others were not.

    Raises:
        InputError: something cannot be used; found before the first run.
    """
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
        batch = run_batch(jobs, arguments.processes, out if arguments.graph else None, bar.update)
    runs: dict[str, dict[str, Any]] = {job.row: {} for job in jobs}
    failures: dict[str, dict[str, str]] = {job.row: {} for job in jobs}
    for job, metrics in batch.metrics.items():
        runs[job.row][job.name] = metrics
    for job, why in batch.failures.items():
        failures[job.row][job.name] = why
    summary = {row: summarise(mine.values(), len(failures[row])) for row, mine in runs.items()}
    return {"summary": summary, "runs": runs, "failures": {row: mine for row, mine in failures.items() if mine}}


def _rows(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Policy, parameters and label of each row: every policy with every combination of what is varied."""
    varied = [("predictor", "model", arguments.predictor or []), *arguments.set]
    rows = []
    for policy in arguments.policy:
        # a replay has no stages of the policy; of others, what is unknown is to be refused
        mine = [s for s in varied if s[2] and (policy != REPLAY or s[0] not in POLICY_STAGES)]
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
    """Policies side by side; what is measured of fewer runs than there are is marked."""
    lacking = {policy: f"{row['measured']} of {row['runs']}" for policy, row in summary.items() if row["failed"]}
    caption = "; ".join(f"{policy}: {some}" for policy, some in lacking.items())
    table = Table(title=title, title_justify="left", caption_justify="left")
    table.caption = f"{MARK} over the runs that did not fail: {caption}" if lacking else None
    table.add_column("")
    for policy in summary:
        table.add_column(policy, justify="right")
    for name, key in COLUMNS.items():
        table.add_row(name, *(_cell(key, row[key]) + _mark(key, row) for row in summary.values()))
    for horizon in ("5", "10", "15", "20", "25"):
        if any(row["ade_all_m"][horizon] is not None for row in summary.values()):
            both = (f"{_both(row, horizon)}{_mark('', row)}" for row in summary.values())
            table.add_row(f"ADE@{horizon} s m, controlled / all", *both)
    Console().print(table)


def _both(row: dict[str, Any], horizon: str) -> str:
    return " / ".join(_cell("", row[name][horizon]) for name in ("ade_controlled_m", "ade_all_m"))


def _mark(key: str, row: dict[str, Any]) -> str:
    """What follows a figure that leaves runs out: all do where runs have failed, but for those that count them."""
    return MARK if row["failed"] and key not in OF_ALL_RUNS else ""


def problems(result: dict[str, Any]) -> list[str]:
    """Every run that failed or is not valid, a line each, with the reason."""
    failed = [(row, run, f"failed: {why}") for row, mine in result["failures"].items() for run, why in mine.items()]
    invalid = [
        (row, run, f"not valid: {metrics['why']}")
        for row, mine in result["runs"].items()
        for run, metrics in mine.items()
        if not metrics["valid"]
    ]
    return [f"{row}: {run}: {why}" for row, run, why in (*failed, *invalid)]


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


@program
def main(argv: list[str] | None = None) -> int:
    """Entry point of ``ros2 run litsim_policy evaluate``."""
    arguments = parser().parse_args(argv)
    result = evaluate(arguments)
    path = Path(arguments.out) / "evaluation.json"
    path.write_text(json.dumps(result, indent=2) + "\n")
    shell = "over DDS" if arguments.graph else "in process"
    several = f"{len(arguments.scenario)} scenarios"
    name = arguments.scenario[0] if len(arguments.scenario) == 1 else several
    print_table(f"{name}, ego {arguments.ego}, {shell}", result["summary"])
    print(f"every run: {path}")
    found = problems(result)
    for problem in found:
        print_error(problem)
    return EXIT_FAILED if found else 0


if __name__ == "__main__":
    main()
