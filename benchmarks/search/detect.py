"""Which cases of a suite catch which planted weakness.

    ./litsim exec python benchmarks/search/detect.py SUITE [SUITE ...] [--policy replay]

Prints a table in Markdown with a row for each weakness of `planted_egos.py`, planted in the careful driver, and a
column for each suite: the number of cases that the careful driver passes and the weak one fails, by the criteria of
`search`, and the kinds of case. What became of the runs is kept in a file beside each suite, and not run again.
"""

from __future__ import annotations

import argparse
import gc
import json
from collections import Counter
from pathlib import Path
from typing import Any, get_args

from planted_egos import PlantedConfig, PlantedEgo, Weakness

from litsim_eval.analysis.metrics import measures_by_field
from litsim_eval.campaign.case import Case, cases_of
from litsim_eval.campaign.criteria import SAFETY, Criteria
from litsim_eval.campaign.suite import Suite
from litsim_eval.runs.case_run import plan_of
from litsim_eval.runs.in_process import record

HEALTHY: Weakness = "none"
LEFT_OUT = "delay"  # `late`, but less
WEAKNESSES: tuple[Weakness, ...] = tuple(name for name in get_args(Weakness) if name != LEFT_OUT)


def passes(case: Case, weakness: Weakness, criteria: Criteria) -> bool:
    """Returns whether the careful driver with a weakness meets the criteria; no other measures are made."""
    plan = plan_of(case)
    run = record(plan, ego=PlantedEgo(plan.scenario, PlantedConfig(weakness=weakness, careful=True)))
    metrics: dict[str, dict[str, Any]] = {}
    for criterion in criteria.runs:
        branch, _, name = criterion.field.partition(".")
        metrics.setdefault(branch, {})[name] = measures_by_field()[criterion.field].of(run)
    gc.collect()
    return all(criterion.of_run(metrics).passed for criterion in criteria.runs)


def has_no_part(case: Case, weakness: Weakness) -> bool:
    """Returns whether nothing is there that a weakness is about: no lights, walkers or ramps."""
    scenario = plan_of(case).scenario
    if weakness in ("red", "amber"):
        return scenario.signals is None
    if weakness == "walkers":
        return not scenario.log.obstacle.any()
    return weakness == "ramp" and not any("ramp" in lane.edge_id for lane in scenario.lane_map.lanes)


def cases(name: str, policy: str) -> list[Case]:
    """Returns the cases of a suite with a policy."""
    return cases_of(Suite.load(name).model_copy(update={"policies": [policy]}))


def outcomes(name: str, policy: str, out: Path) -> dict[str, dict[str, bool]]:
    """Returns by case and weakness whether the driver passes; runs that are not known yet are made."""
    store, criteria = out / f"detected_{Path(name).stem}_{policy}.jsonl", Criteria.load(SAFETY)
    known: dict[str, dict[str, bool]] = {}
    if store.is_file():
        for line in store.read_text().splitlines():
            case, weakness, passed = json.loads(line)
            known.setdefault(case, {})[weakness] = passed
    with store.open("a") as file:
        for case in cases(name, policy):
            of_case = known.setdefault(case.name, {})
            for weakness in WEAKNESSES:
                if weakness not in of_case and (weakness == HEALTHY or of_case[HEALTHY]):
                    of_case[weakness] = has_no_part(case, weakness) or passes(case, weakness, criteria)
                    file.write(json.dumps([case.name, weakness, of_case[weakness]]) + "\n")
                    file.flush()
    return known


def main() -> None:
    """Makes the runs and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suites", nargs="+")
    parser.add_argument("--policy", default="replay")
    parser.add_argument("--out", type=Path, default=Path("bags"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    gc.freeze()  # what is there by now stays: it need not be searched after each run
    found = {name: outcomes(name, arguments.policy, arguments.out) for name in arguments.suites}
    tags = {name: {case.name: case.tags[0] for case in cases(name, arguments.policy)} for name in found}
    heads = [f"{Path(name).stem}, {sum(each[HEALTHY] for each in of.values())} cases" for name, of in found.items()]
    print(f"| weakness | {' | '.join(heads)} |\n|---|{'---|' * len(heads)}")
    for weakness in WEAKNESSES[1:]:
        cells = []
        for name, of in found.items():
            kinds = Counter(tags[name][case] for case, each in of.items() if each[HEALTHY] and not each[weakness])
            texts = ", ".join(f"{kind.replace('_', ' ')} {count}" for kind, count in kinds.most_common())
            cells.append(f"{sum(kinds.values())}: {texts}" if kinds else "0")
        print(f"| `{weakness}` | {' | '.join(cells)} |")
    for name, of in found.items():
        failed = [case for case, each in of.items() if not each[HEALTHY]]
        print(f"{name}: the careful driver fails in {len(failed)} of {len(of)}: {', '.join(failed)}")


if __name__ == "__main__":
    main()
