"""Planted weaknesses: how soon and how near a search finds them, against random search with the same budget.

    ./litsim exec python benchmarks/search/compare.py [--careful | --versions] [--runs 200] [--seeds 5] [--out FOLDER]

Prints a table in Markdown, for TPE and for random search: `tpe / random`. A weakness is found by a failure that the ego
without it does not have with the same changes. `found` is the number of searches that do, `first` the number of runs
until then, `near` that until a failure within 1.25 times the least distance of all searches of the weakness, `margin`
the least distance itself, `any` that of all failures: medians over the seeds, with the budget where there was none.
With --careful it prints instead what the same searches find of an ego that drives as a careful driver, with --versions
the margins of three versions of the ego, one for each seed.

Runs are made in this process, with policy `replay`; what became of them is kept, and not run again. As what random
search tries does not depend on what became of it, only those of its runs are made that the table needs.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from statistics import median
from typing import Any

from planted_egos import PlantedConfig, PlantedEgo

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.campaign.case import Case, cases_of
from litsim_eval.campaign.criteria import SAFETY, Criteria
from litsim_eval.campaign.results import RunResult
from litsim_eval.campaign.suite import Suite
from litsim_eval.runs.case_run import plan_of
from litsim_eval.runs.runner import Runner, record
from litsim_eval.search.explore import SAMPLERS, Exploration, Tried, explore
from litsim_eval.search.judging import Outcome, closeness, missed_by, outcome_of
from litsim_eval.search.people import People
from litsim_eval.search.space import Space
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario, Sources

TRAFFIC = ("brake", "cut_in", "pace", "enter", "start")
PLANTED = (
    ("motorway_02/112", "side", TRAFFIC),
    ("motorway_00/10", "delay", TRAFFIC),
    ("motorway_00/3", "ramp", TRAFFIC),
    ("street_14/67", "red", ("start", "signals")),
)
"""Cases of the suite `small`, the weakness that is looked for in each, and what may change."""
OF_VERSIONS = ("motorway_00/3", "motorway_01/112")
"""Cases in which versions are compared: of two motorways the first of every fourth of the suite that is no jam."""
HEALTHY, CAREFUL = "none", "careful"
"""The ego without a weakness, and the careful driver."""
CHANGED = "changed"
"""Name of changed scenarios."""
VERSIONS = (f"{CAREFUL} late", f"{CAREFUL} soft", CAREFUL)
NEAR = 1.25


def planted(scenario: Scenario, name: str) -> PlantedEgo:
    """Returns the ego with a weakness, the careful driver, or that with a weakness (`careful late`)."""
    weakness = name.removeprefix(CAREFUL).strip() or HEALTHY
    return PlantedEgo(scenario, PlantedConfig(weakness=weakness, careful=name.startswith(CAREFUL)))


class Road:
    """A case with its spaces, and what became of the runs in it, by weakness and content of the scenario."""

    def __init__(self, case: Case, changes: Sequence[str], out: Path) -> None:
        self._case, self._plan, self._changes = case, plan_of(case), changes
        self._spaces: dict[str, Space] = {}
        file = self._plan.scenario.file
        self._sources = Sources(load_recording(Path(file.recording), file.crop), self._plan.scenario.lane_map)
        self._changed = out / "changed.yaml"
        self._store = out / f"{'_'.join(case.name.split('/')[:2])}.jsonl"
        lines = self._store.read_text().splitlines() if self._store.is_file() else []
        self._outcomes: dict[str, list[Any]] = dict(map(json.loads, lines))
        self._criteria = Criteria.load(SAFETY)

    def space(self, weakness: str) -> Space:
        """Returns the space around where the ego drives with a weakness."""
        if weakness not in self._spaces:
            run = record(Runner(self._plan, ego=planted(self._plan.scenario, weakness)))
            driven = Log.from_rows(run.steps.stacked, len(run.steps))
            self._spaces[weakness] = Space.of(self._plan.scenario, People.load(), self._changes, driven)
        return self._spaces[weakness]

    def outcome(self, text: str, weakness: str) -> tuple[Outcome, str, float]:
        """Returns what became of a run of a scenario, what happened first, and how near to a contact it came."""
        key = f"{weakness} {hashlib.sha256(text.encode()).hexdigest()}"
        if key not in self._outcomes:
            self._outcomes[key] = [*self._run(text, weakness)]
            with self._store.open("a") as store:
                store.write(json.dumps([key, self._outcomes[key]]) + "\n")
        outcome, group, near = self._outcomes[key]
        return Outcome(outcome), group, near

    def _run(self, text: str, weakness: str) -> tuple[Outcome, str, float]:
        self._changed.write_text(text)
        try:
            scenario = Scenario.load(self._changed, sources=self._sources)
        except InputError:
            return Outcome.ERROR, "", 0.0
        ego = planted(scenario, weakness)
        gc.collect()  # the run before: it refers to itself, and the collector does not know how large arrays are
        run = record(Runner(replace(self._plan, scenario=scenario), ego=ego))
        result = RunResult.judged(self._case, compute_metrics(run), self._criteria)
        outcome = outcome_of(result, scenario.history_steps)
        return outcome, missed_by(result) if outcome == Outcome.FAILED else "", closeness(result.metrics)


@dataclass
class Searched:
    """What a search of a weakness has tried; what became of it is asked for once it matters."""

    road: Road
    weakness: str
    space: Space
    tried: Sequence[Tried]

    def fails(self, tried: Tried, weakness: str) -> bool:
        """Returns whether the ego fails with a weakness."""
        text = self.space.scenario_file(tried.proposal, CHANGED)
        return self.road.outcome(text, weakness)[0] == Outcome.FAILED

    def fails_alone(self, tried: Tried) -> bool:
        """Returns whether the ego fails with the weakness, and does not without it."""
        return self.fails(tried, self.weakness) and not self.fails(tried, HEALTHY)

    def until(self, distance: float, budget: int) -> int:
        """Returns the number of runs until the weakness alone fails within `distance`; the budget if it never does."""
        near = (each for each in self.tried if each.distance <= distance)
        return next((each.number for each in near if self.fails_alone(each)), budget)

    def margins(self) -> tuple[float, float]:
        """Returns the least distance of a failure of the weakness alone, and of any; infinite for none."""
        ordered = sorted(self.tried, key=lambda each: (each.distance, each.number))
        alone = next((each.distance for each in ordered if self.fails_alone(each)), inf)
        return alone, next((each.distance for each in ordered if self.fails(each, self.weakness)), inf)


def searched(road: Road, weakness: str, sampler: str, seed: int, runs: int) -> Searched:
    """Returns a search, with its runs made if its proposals depend on them."""
    exploration = Exploration(road.space(weakness))
    searching = explore(exploration, runs, sampler, seed)
    asked = next(searching)
    with suppress(StopIteration):
        while True:
            tried = []
            for number, (how, proposal) in enumerate(asked, len(exploration.tried)):
                lazy = sampler == "random"
                text = exploration.space.scenario_file(proposal, CHANGED)
                outcome, group, near = (Outcome.PASSED, "", 0.0) if lazy else road.outcome(text, weakness)
                distance = exploration.space.distance(proposal)
                tried.append(Tried(number, how, proposal, distance, outcome, group, near))
            asked = searching.send(tried)
    return Searched(road, weakness, exploration.space, exploration.tried)


def print_planted(roads: dict[str, Road], seeds: int, budget: int) -> None:
    """Prints a row for each weakness, with a number for each sampler in each cell."""
    print("| case | weakness | found | first | near | margin | any |\n|---|---|---:|---:|---:|---:|---:|", flush=True)
    for case, weakness, _ in PLANTED:
        searches = {
            sampler: [searched(roads[case], weakness, sampler, seed, budget) for seed in range(seeds)]
            for sampler in SAMPLERS
        }
        margins = {sampler: [each.margins() for each in some] for sampler, some in searches.items()}
        print(f"{case}: {margins}", file=sys.stderr, flush=True)
        least = min(alone for some in margins.values() for alone, _ in some)
        columns = []
        for sampler, some in searches.items():
            alone, anyway = zip(*margins[sampler], strict=True)
            runs = [median(each.until(distance, budget) for each in some) for distance in (inf, NEAR * least)]
            counts = [sum(each < inf for each in alone), *runs]
            columns.append([f"{each:g}" for each in counts] + [f"{median(each):.2f}" for each in (alone, anyway)])
        cells = (case, f"`{weakness}`", *map(" / ".join, zip(*columns, strict=True)))
        print(f"| {' | '.join(cells)} |", flush=True)


def print_careful(roads: dict[str, Road], seeds: int, budget: int) -> None:
    """Prints a row for each case with what became of the runs of the careful driver."""
    outcomes = [each for each in Outcome if each != Outcome.PASSED]
    print(
        f"\n| case | runs | {' | '.join(outcomes)} | what failed |\n|---|---:|{'---:|' * len(outcomes)}---|", flush=True
    )
    for case, road in roads.items():
        count, groups, runs = Counter[Outcome](), Counter[str](), 0
        for seed in range(seeds):
            for each in searched(road, CAREFUL, SAMPLERS[0], seed, budget).tried:
                count[each.outcome] += 1
                groups[each.group] += each.outcome == Outcome.FAILED
                runs += 1
        failed = ", ".join(f"{group} {n}" for group, n in groups.most_common() if n) or "-"
        print(f"| {case} | {runs} | {' | '.join(str(count[each]) for each in outcomes)} | {failed} |", flush=True)


def print_versions(roads: dict[str, Road], seeds: int, budget: int) -> None:
    """Prints a row for each case with the margins of each version; a dash for none."""
    print(
        f"\n| case | {' | '.join(f'`{version}`' for version in VERSIONS)} |\n|---|{'---|' * len(VERSIONS)}", flush=True
    )
    for case, road in roads.items():
        cells = []
        for version in VERSIONS:
            some = [searched(road, version, SAMPLERS[0], seed, budget) for seed in range(seeds)]
            margins = [
                min((t.distance for t in each.tried if t.outcome == Outcome.FAILED), default=None) for each in some
            ]
            tries = sum(len(each.tried) for each in some)
            cells.append(", ".join("-" if m is None else f"{m:.2f}" for m in margins) + f" in {tries} runs")
        print(f"| {case} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Makes every search and prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("bags/planted"))
    parser.add_argument("--careful", action="store_true", help="search with the careful driver")
    parser.add_argument("--versions", action="store_true", help="compare three versions of the ego")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    suite = Suite.load("small").model_copy(update={"policies": ["replay"]})
    cases = {"/".join(case.name.split("/")[:2]): case for case in cases_of(suite)}
    searched_for = {case: changes for case, _, changes in PLANTED}
    if arguments.versions:
        searched_for = dict.fromkeys(OF_VERSIONS, (*TRAFFIC, "cut_out"))
    roads = {case: Road(cases[case], changes, arguments.out) for case, changes in searched_for.items()}
    gc.freeze()
    how = print_versions if arguments.versions else print_careful if arguments.careful else print_planted
    how(roads, arguments.seeds, arguments.runs)


if __name__ == "__main__":
    main()
