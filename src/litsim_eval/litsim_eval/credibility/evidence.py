"""The evidence pack: what a safety engineer attaches to an assessment of the simulation's credibility."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from litsim_eval.campaign.case import file_digest
from litsim_eval.credibility.measures import measures
from litsim_eval.credibility.page import PAGE_FILE
from litsim_eval.credibility.reading import DataFile
from litsim_eval.credibility.results import BARS_FILE, CSV_FILE, JSON_FILE, Results, bars_path, judged, write_rows
from litsim_eval.report.pages import render_text
from litsim_eval.report.wording import leaf
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing, write_text
from litsim_sim.io.yaml_input import read_text

TEXT_FILE, DATA_FILE, SUMS_FILE = "evidence.md", "data.csv", "SHA256SUMS"
PACK = (TEXT_FILE, JSON_FILE, CSV_FILE, PAGE_FILE, BARS_FILE, DATA_FILE)
"""Files of a pack; :data:`SUMS_FILE` lists them in the format of the program sha256sum."""
LISTED_MAX = 20  # most files of data in the text
_SUM = re.compile(r"(?P<digest>[0-9a-f]{64}) [ *](?P<name>[^/\n]+)")


def write_evidence(results: Results, data: Iterable[DataFile], command: str, folder: Path) -> str:
    """Writes text, criteria and sums of a pack to `folder`, which has its other files, and returns the sums' SHA-256.

    Raises:
        InputError: a file cannot be written.
    """
    files = list(data)
    with replacing(folder / BARS_FILE) as new:
        new.write_bytes(bars_path().read_bytes())
    write_rows(map(asdict, files), folder / DATA_FILE)
    text = render_text(
        "evidence.md.j2",
        command=command,
        results=results,
        data=files[:LISTED_MAX],
        more=max(len(files) - LISTED_MAX, 0),
        policies={name: list(_rows(own)) for name, own in results.measures.items()},
        measures=[(measure.name, measure.text) for measure in measures() if not measure.drawn or results.drivers > 1],
    )
    write_text(folder / TEXT_FILE, text)
    write_text(folder / SUMS_FILE, "".join(f"{file_digest(folder / name)}  {name}\n" for name in PACK))
    return file_digest(folder / SUMS_FILE)


def changes(folder: Path) -> list[str]:
    """Returns what is different from when the pack in `folder` was written, a line for each file; empty if nothing is.

    Raises:
        InputError: there is no pack, or its list of sums is malformed.
    """
    path, expected = folder / SUMS_FILE, {}
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if (match := _SUM.fullmatch(line)) is None:
            raise InputError(f"{path}: line {number}: {line[:80]!r}, expected a SHA-256 and a file name")
        expected[match["name"]] = match["digest"]
    present = {path.name for path in folder.iterdir()} - {SUMS_FILE}
    return [
        *(f"{name}: is missing" for name in sorted(expected.keys() - present)),
        *(f"{name}: is not of this pack" for name in sorted(present - expected.keys())),
        *(
            f"{name}: has changed: SHA-256 is {digest}, expected {expected[name]}"
            for name in sorted(expected.keys() & present)
            if (digest := file_digest(folder / name)) != expected[name]
        ),
    ]


def _rows(figures: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yields the bars for a policy: name, value, interval, limit and verdict."""
    for result in judged(figures):
        interval = figures.get(f"{result.field}_interval")
        between = f"{leaf(interval[0])} to {leaf(interval[1])}" if interval else leaf(None)
        yield result.name, leaf(result.value), between, result.limit, "met" if result.passed else "**not met**"
