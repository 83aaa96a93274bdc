"""Writes the tables of docs/metrics.md from the measures: field, unit, direction and meaning.

    ./litsim exec python tools/measures.py

They stand between marks that name families of measures. A test finds a page that is out of date.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from litsim_eval.analysis.measure import Measure
from litsim_eval.analysis.measures.lockstep import VALIDITY
from litsim_eval.analysis.metrics import FAMILIES

PAGE = Path(__file__).resolve().parents[1] / "docs/metrics.md"
BLOCK = re.compile(r"(<!-- begin: measures ([\w ]+) -->\n).*?(<!-- end: measures -->)", re.DOTALL)
DOCUMENTED = FAMILIES | {"validity": VALIDITY}


def table(families: Sequence[str]) -> str:
    """Returns the table of some families, with a row for all measures of one text."""
    lines = ["| field | unit | better | meaning |", "|---|---|---|---|"]
    for family in families:
        by_text: dict[str, list[Measure]] = {}
        for measure in DOCUMENTED[family]:
            by_text.setdefault(measure.text, []).append(measure)
        lines += [row(measures, text) for text, measures in by_text.items()]
    return "\n".join(lines) + "\n"


def row(measures: Sequence[Measure], text: str) -> str:
    """Returns the row of measures with one text; of those in one branch, it names the branch once."""
    names, branch = [], ""
    for measure in measures:
        above, _, leaf = measure.name.rpartition(".")
        brackets = "[]" if list in measure.kinds else ""
        names.append(f"`{f'.{leaf}' if above and above == branch else measure.name}{brackets}`")
        branch = above
    units, arrows = (dict.fromkeys(each) for each in ((m.unit for m in measures), (m.better.arrow for m in measures)))
    return f"| {', '.join(names)} | {', '.join(filter(None, units))} | {''.join(arrows).strip()} | {text} |"


def page(text: str) -> str:
    """Returns the text of the page with its tables as they are today."""
    return BLOCK.sub(lambda block: block[1] + table(block[2].split()) + block[3], text)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
