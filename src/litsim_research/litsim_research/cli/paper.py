"""`paper`: run the paper's experiments, each a campaign that can be resumed, and make their tables and figures."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path

from litsim_eval.analysis.measure import Metrics
from litsim_eval.campaign.results import Campaign, read_campaign
from litsim_eval.campaign.suite import CAMPAIGN_FILE, Suite
from litsim_research.paper import claims, tables
from litsim_research.paper.experiments import (
    ABLATIONS,
    DEVIATING,
    EXPERIMENTS,
    OURS,
    PAPER_EGO,
    PAPER_SETUP,
    REGIONS,
    TABLE,
    Experiment,
)
from litsim_research.paper.measures import Key
from litsim_research.paper.page import fill
from litsim_research.paper.roads import REAL, SETS
from litsim_research.paper.running import carried_out
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import at_least_one, interrupt_on_signals, program
from litsim_sim.core.errors import InputError
from litsim_sim.io.yaml_input import read_text
from litsim_sim.scenario.run_info import driver_names

DEFAULT_OUT = "bags/paper"
CASES = "cases"
FIGURES = "figures"
ALL = "all"
GOALS = "goals"
CLAIMS = "claims"
SHOWN = (GOALS, TABLE.name, REGIONS.name, DEVIATING.name, ABLATIONS.name, CLAIMS)
"""Tables that a page shows in short; all of them are CSV files beside it."""
CAPTIONS = {
    "contacts_by_fault": "Contacts that are not in the log, by fault; by ego, all sets together.",
    "ade_over_time": "ADE up to each horizon, paired over the agents that any method drives; by ego and set.",
    "takeovers": "Time off the log, and distance from it at release; all egos, all sets.",
    "realism": "Realism of the agents near the ego's log, by set, with the spread over seeds; ego `bat`.",
    "case_lane_change": "An ego changes lane, unlike its log, on US-101: replay above, LitSim below.",
    "case_left_turn": "An unprotected left turn on the generated street: replay above, LitSim below.",
}
EPILOG = (
    "If interrupted, the same command resumes. 'claims' counts in how many tables of 'table' and 'ablation' each claim "
    "of the paper holds; 'figures' draws the runs of 'table'; 'cases' runs and draws the two case studies; 'all' does "
    "everything. The real window needs LITSIM_DATA; without it, it is left out with a note."
)


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research paper``."""
    p = Parser(prog="paper", description=__doc__, epilog=EPILOG, formatter_class=DefaultsFormatter)
    parts = (*EXPERIMENTS, CLAIMS, FIGURES, CASES, ALL)
    p.add_argument("what", choices=parts, help="experiment to run, or output to make")
    p.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS), help="sets of cases")
    p.add_argument(
        "--ego", nargs="+", choices=driver_names(), help="what drives the ego, instead of the experiment's own"
    )
    p.add_argument("--out", type=Path, default=Path(DEFAULT_OUT), help="folder of campaigns, tables and figures")
    p.add_argument("--processes", type=at_least_one, default=2, help="number of runs at a time")
    p.add_argument("--quick", action="store_true", help="only a few short runs, as a trial")
    p.add_argument("--overwrite", action="store_true", help="start afresh if the sources have changed since")
    p.add_argument("--as-it-is", action="store_true", help="run nothing; make tables and figures from existing runs")
    p.add_argument(
        "--page",
        type=Path,
        help="Markdown file whose marked parts are filled, such as docs/results.md; CSV files go beside it",
    )
    p.add_argument("--images", type=Path, help="folder of the figures (default: figures in --out)")
    return p


def short_table(experiment: Experiment, records: Sequence[tables.Row]) -> list[str]:
    """Returns lines of the table that stands for the `records` of `experiment` on a page."""
    short = [row for row in records if row.ego in experiment.short_egos] or records
    return tables.summary(short, counts_alone=experiment.counts_alone)


class Work:
    """Runs the experiments and writes tables and figures, as the arguments ask."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._arguments = arguments
        self._out: Path = arguments.out
        self._images: Path = arguments.images or self._out / FIGURES
        if arguments.page is not None:
            read_text(arguments.page)  # before anything is run

    @cached_property
    def _sets(self) -> tuple[str, ...]:
        return _available(self._arguments.sets)

    def experiment(self, experiment: Experiment) -> None:
        """Run `experiment`, and write its tables."""
        campaign = self._campaign(experiment)
        egos = self._egos(experiment)
        records = _rows(campaign, experiment, egos, self._sets if experiment.by_set else (None,))
        self._write(experiment.name, records, short_table(experiment, records))
        if experiment.aimed:
            reached = [row for ego in egos for row in tables.goals(tables.methods_of(campaign, ego, None), ego)]
            self._write(GOALS, reached, tables.goals_table(reached))

    def claims(self) -> None:
        """Write in how many of the existing tables the paper's claims hold.

        Raises:
            InputError: the tables of `table` and `ablation` have not been made.
        """
        files = [self._folders()[-1] / f"{experiment.name}.csv" for experiment in (TABLE, ABLATIONS)]
        for path in files:
            if not path.is_file():
                raise InputError(f"{path}: missing, expected the table of `paper {path.stem}`")
        table, ablation = (tables.read_csv(path, tables.Row) for path in files)
        records = claims.claim_rows(table, ablation)
        self._write(CLAIMS, records, claims.claims_table(records))

    def figures(self) -> None:
        """Draw the figures of the table's campaign."""
        from litsim_research.paper import figures  # matplotlib takes half a second to load

        campaign = self._campaign(TABLE)
        egos = self._egos(TABLE)
        together = {ego: tables.methods_of(campaign, ego, None) for ego in egos}
        by_set = {ego: {name: tables.methods_of(campaign, ego, name) for name in self._sets} for ego in egos}
        every_ego: dict[str, dict[Key, Metrics | None]] = {}
        for methods in together.values():
            for name, runs in methods.items():
                every_ego.setdefault(name, {}).update(runs)
        canvases = {
            "contacts_by_fault": figures.contacts_by_fault(together),
            "ade_over_time": figures.ade_over_time(by_set),
            "takeovers": figures.takeovers(every_ego, (OURS, PAPER_SETUP)),
            "realism": figures.realism(by_set[egos[0]]),
        }
        for name, canvas in canvases.items():
            figures.save(canvas, self._images, name)
        print(f"figures: {self._images}")
        self._show()

    def cases(self) -> None:
        """Run and draw the case studies."""
        from litsim_research.paper import case_studies, figures

        arguments = self._arguments
        for name in case_studies.STUDIES:
            if name == case_studies.LANE_CHANGE and REAL not in self._sets:
                continue
            where = f"cases_{name}"
            if arguments.as_it_is:
                campaign = read_campaign(self._out / where)
            else:
                suite = case_studies.candidates(name, self._out / "roads", quick=arguments.quick)
                campaign = self._carried_out(suite, where)
            study = case_studies.chosen(campaign, case_studies.EVENTS.get(name))
            if study is None:
                print(f"{name}: no case in which the ego has such a contact under replay and none under {OURS}")
                for old in self._images.glob(f"case_{name}.*"):  # of earlier runs
                    old.unlink()
                continue
            figures.save(case_studies.drawn(name, study), self._images, f"case_{name}")
            print(f"{name}: {study.ours.name}")
        self._show()

    def _show(self) -> None:
        """Put the existing figures into the page."""
        page = self._arguments.page
        if page is None:
            return
        there = [name for name in CAPTIONS if (self._images / f"{name}.png").is_file()]
        folder = os.path.relpath(self._images, page.parent)
        lines = [
            line
            for name in there
            for line in (f"![{name.replace('_', ' ')}]({folder}/{name}.png)", "", CAPTIONS[name], "")
        ]
        fill(page, f"paper {FIGURES}", lines)

    def times(self) -> None:
        """Write the computing time of each campaign in the folder."""
        lines = ["campaign,runs,process_minutes"]
        for folder in sorted(path.parent for path in self._out.glob(f"*/{CAMPAIGN_FILE}")):
            results = read_campaign(folder).results
            minutes = sum(result.wall_s or 0.0 for result in results) / 60
            lines.append(f"{folder.name},{len(results)},{minutes:.1f}")
        for folder in self._folders():
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "times.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")

    def _campaign(self, experiment: Experiment) -> Campaign:
        if self._arguments.as_it_is:
            return read_campaign(self._out / experiment.name)
        egos, quick = self._egos(experiment), self._arguments.quick
        return self._carried_out(experiment.suite(self._sets, egos, self._out / "roads", quick=quick), experiment.name)

    def _carried_out(self, suite: Suite, name: str) -> Campaign:
        arguments = self._arguments
        return carried_out(suite, self._out / name, arguments.processes, overwrite=arguments.overwrite)

    def _egos(self, experiment: Experiment) -> tuple[str, ...]:
        chosen: Sequence[str] | None = self._arguments.ego
        if chosen and not experiment.own_egos:
            return tuple(chosen)
        return experiment.egos[:1] if self._arguments.quick else experiment.egos

    def _folders(self) -> tuple[Path, ...]:
        """Where CSV files go: to `--out`, and into the folder beside the page that is named like it."""
        page: Path | None = self._arguments.page
        return (self._out,) if page is None else (self._out, page.with_suffix(""))

    def _write(self, name: str, records: Sequence[tables.R], lines: Sequence[str]) -> None:
        """Write `records` to NAME.csv, and `lines` to standard output and, if the page shows them, into the page."""
        for folder in self._folders():
            tables.write_csv(folder / f"{name}.csv", records)
        print("\n".join(lines))
        if self._arguments.page is not None and name in SHOWN:
            fill(self._arguments.page, f"paper {name}", lines)


def _available(sets: Sequence[str]) -> tuple[str, ...]:
    """Returns the `sets` with available data.

    Raises:
        InputError: there are none.
    """
    available = tuple(name for name in sets if name != REAL or os.environ.get("LITSIM_DATA"))
    if not available:
        raise InputError("--sets real: LITSIM_DATA is not set, expected a folder of recorded data")
    if len(available) < len(sets):
        print("real: left out, since LITSIM_DATA is not set to a folder of recorded data")
    return available


def _rows(
    campaign: Campaign, experiment: Experiment, egos: Sequence[str], sets: Sequence[str | None]
) -> list[tables.Row]:
    """Returns the rows of an experiment's table: all methods for each ego and set; None means all sets together."""
    records: list[tables.Row] = []
    for ego in egos:
        for tag in sets:
            records += tables.rows(tables.methods_of(campaign, ego, tag), ego, tag)
        if ego == PAPER_EGO:
            records += tables.published_rows(ego, experiment.published)
    return records


@program
def main(argv: list[str] | None = None) -> int:
    """Entry point of ``ros2 run litsim_research paper``."""
    arguments = parser().parse_args(argv)
    interrupt_on_signals()
    work = Work(arguments)
    parts: dict[str, Callable[[], None]] = {
        **{name: partial(work.experiment, experiment) for name, experiment in EXPERIMENTS.items()},
        CLAIMS: work.claims,
        FIGURES: work.figures,
        CASES: work.cases,
    }
    for name in parts if arguments.what == ALL else (arguments.what,):
        parts[name]()
    if arguments.what != CLAIMS:
        work.times()
    return 0
