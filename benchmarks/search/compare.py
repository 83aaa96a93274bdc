"""Planted weaknesses: how soon and how near `search` finds them, against plain random search with the same budget.

    ./litsim exec python benchmarks/search/compare.py [--runs 100] [--seeds 3] [--out bags/planted]

Prints a table in Markdown. `first` is the number of runs until the first failure that counts, `near` that until one
within 1.25 times the least distance that any search has found in that scenario, both as medians over the seeds with the
budget where there was none.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from itertools import product
from pathlib import Path
from statistics import median

import pyarrow.parquet as pq
from planted_egos import install

PLANTED = (
    ("none", "motorway_00/3"),
    ("side", "motorway_00/3"),
    ("delay", "motorway_00/3"),
    ("ramp", "motorway_00/3"),
    ("red", "street_14/67"),
)
"""Each weakness, and the case of the suite `small` in which it is looked for."""
SAMPLERS = ("tpe", "random")
NEAR = 1.25
LITSIM = Path(__file__).parents[2] / "litsim"

Failures = list[tuple[int, float]]
"""Number and distance of each failure, in the order of the runs."""


def failures(weakness: str, case: str, sampler: str, seed: int, runs: int, out: Path) -> Failures:
    """Returns the failures that one search finds."""
    folder = out / f"{weakness}_{sampler}_{seed}"
    words = ["search", "--suite", "small", "--case", case, "--ego", "planted", "--policy", "replay"]
    words += ["--set", f"ego.weakness={weakness}", "--runs", str(runs), "--sampler", sampler]
    words += ["--search-seed", str(seed), "--out", str(folder)]
    done = subprocess.run(
        [LITSIM, *words], check=False, env=os.environ | install(out / "plugins"), capture_output=True, text=True
    )
    if done.returncode not in (0, 1):
        sys.exit(done.stderr)
    tried = pq.read_table(folder / "tried.parquet").to_pandas()
    failed = tried[tried["outcome"] == "failed"]
    return list(zip(failed["number"].tolist(), failed["distance"].tolist(), strict=True))


def until(found: Failures, distance: float, budget: int) -> int:
    """Returns the number of runs until a failure within `distance`; the budget if there is none."""
    return next((number for number, each in found if each <= distance), budget)


def main() -> None:
    """Runs every search and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("bags/planted"))
    arguments = parser.parse_args()
    budget, out = arguments.runs, arguments.out.absolute()
    print("| weakness | case | search | first | near | margin |\n|---|---|---|---:|---:|---:|", flush=True)
    for weakness, case in PLANTED:
        found = {
            (sampler, seed): failures(weakness, case, sampler, seed, budget, out)
            for sampler, seed in product(SAMPLERS, range(arguments.seeds))
        }
        least = min((distance for each in found.values() for _, distance in each), default=float("nan"))
        for sampler in SAMPLERS:
            mine = [each for (name, _), each in found.items() if name == sampler]
            first = median(until(each, float("inf"), budget) for each in mine)
            near = median(until(each, NEAR * least, budget) for each in mine)
            margins = sorted(min((distance for _, distance in each), default=float("inf")) for each in mine)
            margin = "none" if margins[len(margins) // 2] == float("inf") else f"{margins[len(margins) // 2]:.2f}"
            print(f"| `{weakness}` | {case} | {sampler} | {first:g} | {near:g} | {margin} |", flush=True)


if __name__ == "__main__":
    main()
