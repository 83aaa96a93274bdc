"""Planted weaknesses: how soon and how near `search` finds them, against plain random search with the same budget.

    ./litsim exec python benchmarks/search/compare.py [--runs 60] [--seeds 3] [--out bags/planted]

Prints a table in Markdown. `first` is the number of runs until the first failure that counts, `near` that until one
within 1.25 times the least distance that any search has found with that weakness, both as medians over the seeds, with
the budget where there was none. `none` is the ego without a weakness.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from math import inf
from pathlib import Path
from statistics import median

import pyarrow.parquet as pq
from planted_egos import install

PLANTED = (
    ("motorway_02/170", "ramp", ()),
    ("motorway_00/7", "delay", ()),
    ("motorway_02/112", "side", ()),
    ("street_14/56", "red", ("start", "signals")),
)
"""Cases of the suite `small`, the weakness that is looked for in each, and what may change, where that is not all."""
TPE, RANDOM = "tpe", "random"
NEAR = 1.25
LITSIM = Path(__file__).parents[2] / "litsim"

Failures = list[tuple[int, float]]
"""Number and distance of each failure, in the order of the runs."""


def failures(
    case: str, weakness: str, changes: Sequence[str], sampler: str, seed: int, runs: int, out: Path
) -> Failures:
    """Returns the failures that one search finds."""
    folder = out / f"{case.replace('/', '_')}_{weakness}_{sampler}_{seed}"
    words = ["search", "--suite", "small", "--case", case, "--ego", "planted", "--policy", "replay"]
    words += ["--set", f"ego.weakness={weakness}", "--runs", str(runs), "--sampler", sampler]
    words += ["--search-seed", str(seed), "--out", str(folder), *(["--change", *changes] if changes else [])]
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
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("bags/planted"))
    arguments = parser.parse_args()
    budget, out = arguments.runs, arguments.out.absolute()
    print("| case | ego | search | first | near | margin |\n|---|---|---|---:|---:|---:|", flush=True)
    for case, weakness, changes in PLANTED:
        kinds = (("none", TPE), (weakness, TPE), (weakness, RANDOM))
        found = {
            kind: [failures(case, kind[0], changes, kind[1], seed, budget, out) for seed in range(arguments.seeds)]
            for kind in kinds
        }
        of_weakness = [each for kind in kinds[1:] for each in found[kind]]
        least = min((distance for each in of_weakness for _, distance in each), default=inf)
        for (ego, sampler), searches in found.items():
            first, near = (median(until(each, d, budget) for each in searches) for d in (inf, NEAR * least))
            margin = median(min((distance for _, distance in each), default=inf) for each in searches)
            text = "none" if margin == inf else f"{margin:.2f}"
            print(f"| {case} | `{ego}` | {sampler} | {first:g} | {near:g} | {text} |", flush=True)


if __name__ == "__main__":
    main()
