"""What a search finds of planted weaknesses: margins of three versions of an ego, and failures of a careful driver.

    ./litsim exec python benchmarks/search/compare.py --versions | --careful [--runs 200] [--seeds 5] [--out FOLDER]

Prints a table in Markdown: with --versions the margins of three versions of the ego, one for each seed, with --careful
what the same searches find of an ego that drives as a careful driver.

Runs are made in this process, with policy `replay`; what became of them is kept, and not run again.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from planted_egos import PlantedConfig, PlantedEgo, Weakness

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.campaign.case import Case, cases_of
from litsim_eval.campaign.criteria import SAFETY, Criteria
from litsim_eval.campaign.results import RunResult
from litsim_eval.campaign.suite import Suite
from litsim_eval.runs.case_run import plan_of
from litsim_eval.runs.in_process import record
from litsim_eval.search.explore import SAMPLERS, Exploration, Tried, explore
from litsim_eval.search.judging import Outcome, closeness, missed_by, outcome_of
from litsim_eval.search.people import People
from litsim_eval.search.space import Space
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario, Sources

TRAFFIC = ("brake", "cut_in", "pace", "enter", "start")
OF_CAREFUL = {
    "motorway_02/112": TRAFFIC,
    "motorway_00/10": TRAFFIC,
    "motorway_00/3": TRAFFIC,
    "street_14/67": ("start", "signals"),
}
"""Cases of the suite `small` in which the careful driver is searched, and what may change."""
OF_VERSIONS = dict.fromkeys(("motorway_00/3", "motorway_01/112"), (*TRAFFIC, "cut_out"))
"""Cases in which versions are compared: of two motorways the first of every fourth of the suite that is no jam."""
HEALTHY, CAREFUL = "none", "careful"
"""The ego without a weakness, and the careful driver."""
CHANGED = "changed"
"""Name of changed scenarios."""
VERSIONS = (f"{CAREFUL} late", f"{CAREFUL} soft", CAREFUL)


def planted(scenario: Scenario, name: str) -> PlantedEgo:
    """Returns the ego with a weakness, the careful driver, or that with a weakness (`careful late`)."""
    weakness = cast("Weakness", name.removeprefix(CAREFUL).strip() or HEALTHY)
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
            run = record(self._plan, ego=planted(self._plan.scenario, weakness))
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
        run = record(replace(self._plan, scenario=scenario), ego=ego)
        result = RunResult.judged(self._case, compute_metrics(run), self._criteria)
        outcome = outcome_of(result, scenario.history_steps)
        return outcome, missed_by(result) if outcome == Outcome.FAILED else "", closeness(result.metrics)


def searched(road: Road, weakness: str, seed: int, runs: int) -> Sequence[Tried]:
    """Returns what a search has tried."""
    exploration = Exploration(road.space(weakness))
    searching = explore(exploration, runs, SAMPLERS[0], seed)
    asked = next(searching)
    with suppress(StopIteration):
        while True:
            tried = []
            for number, (how, proposal) in enumerate(asked, len(exploration.tried)):
                text = exploration.space.scenario_file(proposal, CHANGED)
                outcome, group, near = road.outcome(text, weakness)
                distance = exploration.space.distance(proposal)
                tried.append(Tried(number, how, proposal, distance, outcome, group, near))
            asked = searching.send(tried)
    return exploration.tried


def print_careful(roads: dict[str, Road], seeds: int, budget: int) -> None:
    """Prints a row for each case with what became of the runs of the careful driver."""
    outcomes = [each for each in Outcome if each != Outcome.PASSED]
    print(
        f"\n| case | runs | {' | '.join(outcomes)} | what failed |\n|---|---:|{'---:|' * len(outcomes)}---|", flush=True
    )
    for case, road in roads.items():
        count, groups, runs = Counter[Outcome](), Counter[str](), 0
        for seed in range(seeds):
            for each in searched(road, CAREFUL, seed, budget):
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
            some = [searched(road, version, seed, budget) for seed in range(seeds)]
            margins = [min((t.distance for t in each if t.outcome == Outcome.FAILED), default=None) for each in some]
            tries = sum(len(each) for each in some)
            cells.append(", ".join("-" if m is None else f"{m:.2f}" for m in margins) + f" in {tries} runs")
        print(f"| {case} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Makes every search and prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("bags/planted"))
    table = parser.add_mutually_exclusive_group(required=True)
    table.add_argument("--careful", action="store_true", help="search with the careful driver")
    table.add_argument("--versions", action="store_true", help="compare three versions of the ego")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    suite = Suite.load("small").model_copy(update={"policies": ["replay"]})
    cases = {"/".join(case.name.split("/")[:2]): case for case in cases_of(suite)}
    searched_for = OF_VERSIONS if arguments.versions else OF_CAREFUL
    roads = {case: Road(cases[case], changes, arguments.out) for case, changes in searched_for.items()}
    gc.freeze()
    (print_versions if arguments.versions else print_careful)(roads, arguments.seeds, arguments.runs)


if __name__ == "__main__":
    main()
