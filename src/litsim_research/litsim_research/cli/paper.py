"""`paper`: run the paper's experiments, each a campaign that can be resumed, and make their tables and figures.

`train` makes the paper's networks anew.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path

from litsim_eval.campaign.results import Campaign, read_campaign
from litsim_eval.campaign.suite import CAMPAIGN_FILE, EgoSetup, Suite
from litsim_research.paper import claims, goals, tables
from litsim_research.paper.experiments import (
    ABLATIONS,
    CHANGED,
    EXPERIMENTS,
    OURS,
    PAPER_EGO,
    TABLE,
    Experiment,
)
from litsim_research.paper.page import fill
from litsim_research.paper.roads import REAL, SETS, missing
from litsim_research.paper.running import carried_out
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import at_least_one, interrupt_on_signals, program
from litsim_sim.core.errors import EXIT_INTERRUPTED, InputError
from litsim_sim.io.yaml_input import read_text
from litsim_sim.scenario.run_info import driver_names

DEFAULT_OUT = "bags/paper"
CASES = "cases"
FIGURES = "figures"
ALL = "all"
GOALS = "goals"
CLAIMS = "claims"
TRAIN = "train"
SHOWN = (GOALS, TABLE.name, ABLATIONS.name, CHANGED.name, CLAIMS)
"""Tables that a page shows in short; all of them are CSV files beside it."""
CAPTIONS = {
    "contacts_by_fault": "Contacts that are not in the log, by fault; egos `brake` and `lane_change`.",
    "case_lane_change": "An ego changes lane, unlike its log, on US-101: replay above, LitSim below.",
    "case_left_turn": "An unprotected left turn on the generated street: replay above, LitSim below.",
}
EPILOG = (
    "If interrupted, the same command resumes. 'claims' counts in how many tables of 'table' and 'ablation' each claim "
    "of the paper holds; 'figures' draws the runs of 'table'; 'cases' runs and draws the two case studies; 'all' does "
    "everything. Recorded roads need LITSIM_DATA, and the repository's root as folder; without them, they are left out "
    "with a note. 'train' makes the paper's predictor and policy C from the packaged configurations, into the folder "
    "'train' of --out; it needs LITSIM_DATA, and about two hours of one core for each seed. 'all' leaves it out: it "
    "drives with the packaged ones."
)


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research paper``."""
    p = Parser(prog="paper", description=__doc__, epilog=EPILOG, formatter_class=DefaultsFormatter)
    parts = (*EXPERIMENTS, CLAIMS, FIGURES, CASES, ALL, TRAIN)
    p.add_argument("what", choices=parts, help="experiment to run, or output to make")
    p.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS), help="sets of cases")
    p.add_argument(
        "--ego", nargs="+", choices=driver_names(), help="what drives the ego, instead of the experiment's own"
    )
    p.add_argument("--out", type=Path, default=Path(DEFAULT_OUT), help="folder of campaigns, tables and figures")
    p.add_argument("--processes", type=at_least_one, default=2, help="number of runs or trainings at a time")
    p.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N", help="seeds of 'train'")
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
        egos = [ego.name for ego in self._egos(experiment)]
        records = _rows(campaign, experiment, egos, self._sets if experiment.by_set else ())
        self._write(experiment.name, records, tables.summary(records, counts_alone=experiment.counts_alone))
        if experiment.aimed:
            groups: list[tuple[str, str | None]] = [(tables.CONFLICTING_EGOS, name) for name in self._sets]
            groups += [(PAPER_EGO, None)] if PAPER_EGO in egos else []
            reached = [
                row
                for ego, name in groups
                for row in goals.goals(tables.methods_of(campaign, _named(ego, egos), name), ego, name)
            ]
            self._write(GOALS, reached, goals.goals_table(reached))

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
        """Draw the contacts of the table's campaign."""
        from litsim_research.paper import figures  # matplotlib takes half a second to load

        campaign = self._campaign(TABLE)
        egos = _named(tables.CONFLICTING_EGOS, [ego.name for ego in self._egos(TABLE)])
        by_set = {tables.SET_NAMES[name]: tables.methods_of(campaign, egos, name) for name in self._sets}
        figures.save(figures.contacts_by_fault(by_set), self._images, "contacts_by_fault")
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

    def _egos(self, experiment: Experiment) -> tuple[EgoSetup, ...]:
        if chosen := self._arguments.ego:
            return tuple(EgoSetup(name=ego, kind=ego) for ego in chosen)
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
    """Returns the `sets` whose data are there.

    Raises:
        InputError: there are none.
    """
    lacking = {name: why for name in sets if (why := missing(name))}
    available = tuple(name for name in sets if name not in lacking)
    if not available:
        raise InputError("--sets " + "; ".join(f"{name}: {why}" for name, why in lacking.items()))
    for name, why in lacking.items():
        print(f"{name}: left out, since {why}")
    return available


def _named(ego: str, egos: Sequence[str]) -> list[str]:
    """Returns those of `egos` that a table calls `ego`."""
    return [name for name in egos if name != PAPER_EGO] if ego == tables.CONFLICTING_EGOS else [ego]


def _rows(campaign: Campaign, experiment: Experiment, egos: Sequence[str], sets: Sequence[str]) -> list[tables.Row]:
    """Returns the rows of an experiment: for each ego on each of the `sets`, then for egos and sets together."""
    groups: list[tuple[str, str | None]] = [(ego, name) for ego in egos for name in sets]
    groups += [(tables.CONFLICTING_EGOS, name) for name in (*sets, None)]
    records = [
        row
        for ego, name in groups
        for row in tables.rows(tables.methods_of(campaign, _named(ego, egos), name), ego, name)
    ]
    return records + tables.published_rows(tables.CONFLICTING_EGOS, experiment.published)


def trained(arguments: argparse.Namespace) -> int:
    """Make the paper's networks as the `arguments` ask, print where they are, and return the exit status."""
    from litsim_research.paper import training

    out: Path = arguments.out / TRAIN
    wanted = training.jobs(out, arguments.seeds, quick=arguments.quick)
    try:
        training.train(wanted, out, arguments.processes)
    except KeyboardInterrupt:
        print(f"\ninterrupted; the same command continues; {out / training.SUMMARY}.csv says where", file=sys.stderr)
        return EXIT_INTERRUPTED
    print("\n".join(training.summary(wanted)))
    return 0


@program
def main(argv: list[str] | None = None) -> int:
    """Entry point of ``ros2 run litsim_research paper``."""
    arguments = parser().parse_args(argv)
    interrupt_on_signals()
    if arguments.what == TRAIN:
        return trained(arguments)
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
