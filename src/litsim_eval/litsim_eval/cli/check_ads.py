"""`check_ads`: let a driving system drive the ego for some seconds, and judge it by the ego port's contract."""

from __future__ import annotations

import argparse
import os
import tempfile
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console
from rich.table import Table

from litsim_eval.check_ads.requirements import Clause, Verdict, judge
from litsim_eval.check_ads.session import Check, observe
from litsim_sim.cli.arguments import DefaultsFormatter, Parser, number, positive
from litsim_sim.cli.program import interrupt_on_signals, program
from litsim_sim.core.errors import EXIT_FAILED, InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.io.files import make_folder, write_json
from litsim_sim.launch.domain import graph_domain
from litsim_sim.launch.middleware import check_security
from litsim_sim.scenario.scenario import Scenario

COLOURS = {Verdict.PASS: "green", Verdict.FAIL: "red", Verdict.OPEN: "yellow"}


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_eval check_ads``."""
    p = Parser(
        prog="check_ads",
        description=__doc__,
        epilog="Exit status: 0, every clause passes; 1, one does not; 2, bad input.",
        formatter_class=DefaultsFormatter,
    )
    p.add_argument("--scenario", default="demo", help="name of a packaged scenario, or a YAML file")
    p.add_argument(
        "--seconds", type=number(STEP_S), default=4.0, metavar="S", help="driving time after the history [s]"
    )
    p.add_argument(
        "--wait",
        type=positive,
        default=30.0,
        metavar="S",
        help="time to wait for a publisher, then for its first answer [s]",
    )
    p.add_argument(
        "--answer-timeout", type=positive, default=5.0, metavar="S", help="timeout of every later answer [s]"
    )
    p.add_argument(
        "--end-wait",
        type=positive,
        default=5.0,
        metavar="S",
        help="time after the run within which the stack must fall silent [s]",
    )
    p.add_argument(
        "--latency-limit",
        type=positive,
        metavar="MS",
        help="limit that 95 %% of the answers must meet; default: the timeout",
    )
    p.add_argument(
        "--clipped-limit",
        type=number(0.0, 1.0),
        default=0.1,
        metavar="SHARE",
        help="largest share of answers beyond the vehicle's limits",
    )
    p.add_argument("--warm", action="store_true", help="let the stack drive a second run, as --warm of campaigns does")
    p.add_argument("--ego-id", type=int, help="vehicle of the recording that is the ego; default: the scenario's")
    p.add_argument("--domain-id", type=int, help="default: ROS_DOMAIN_ID, else 0, or a free domain with COMMAND")
    p.add_argument("--json", type=Path, metavar="FILE", help="write the result here")
    p.add_argument("--out", type=Path, metavar="FOLDER", help="keep record and logs here")
    p.add_argument(
        "command",
        nargs="*",
        metavar="COMMAND",
        help="after --: command that starts the stack; without it, start it yourself",
    )
    return p


def check_ads(arguments: argparse.Namespace, console: Console) -> int:
    """Checks a stack and returns the exit status; raises InputError if an argument or a file cannot be used."""
    check_security(os.environ)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    scenario = Scenario.load(arguments.scenario, ego=arguments.ego_id, simulation_s=arguments.seconds)
    with ExitStack() as stack:
        domain_id = stack.enter_context(graph_domain(arguments.domain_id, reserve=bool(arguments.command)))
        out = arguments.out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="check_ads_")))
        console.print(f"waiting for a stack in ROS_DOMAIN_ID {domain_id}, for {arguments.wait:g} s", highlight=False)
        check = Check(
            scenario=scenario,
            out=_writable(out),
            domain_id=domain_id,
            command=arguments.command,
            wait_s=arguments.wait,
            answer_timeout_s=arguments.answer_timeout,
            end_wait_s=arguments.end_wait,
            warm=arguments.warm,
        )
        evidence = observe(check)
    latency_ms = arguments.latency_limit or 1e3 * arguments.answer_timeout
    clauses = judge(evidence, latency_ms=latency_ms, clipped=arguments.clipped_limit)
    passed = all(clause.verdict == Verdict.PASS for clause in clauses)
    console.print(_table(clauses))
    for remark in evidence.remarks:
        console.print(f"/diagnostics: {remark}", highlight=False, markup=False, soft_wrap=True)
    if arguments.json:
        result = {
            "passed": passed,
            "scenario": scenario.name,
            "steps": scenario.total_steps,
            "clauses": {
                judged.name: {"verdict": judged.verdict, "why": judged.text, **judged.figures} for judged in clauses
            },
            "remarks": evidence.remarks,
        }
        write_json(arguments.json, result)
    return 0 if passed else EXIT_FAILED


def _table(clauses: list[Clause]) -> Table:
    table = Table(title="the ego port's contract", expand=True)
    table.add_column("clause", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    table.add_column("why", ratio=1)
    for clause in clauses:
        table.add_row(clause.name, f"[{COLOURS[clause.verdict]}]{clause.verdict}[/]", clause.text.replace("[", r"\["))
    return table


def _writable(out: Path) -> Path:
    """Creates the folder `out` for the record, or fail before anything is started."""
    if any(out.glob("*.mcap")):
        raise InputError(f"{out}: holds a recording already; give another --out")
    make_folder(out / "log")
    return out


@program
def main() -> int:
    """Runs ``ros2 run litsim_eval check_ads``."""
    arguments = parser().parse_args()
    interrupt_on_signals()  # so that child processes are ended
    return check_ads(arguments, Console())
