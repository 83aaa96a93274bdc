"""The page of a search in a real browser."""

from pathlib import Path
from typing import Any

from litsim_eval.report.margins import write_margins_page

SCENARIO: dict[str, Any] = {
    "name": "motorway_00/3/external/litsim",
    "recorded": "passed",
    "margin": None,
    "reason": "",
    "failures": [],
    "tries": {"nothing": 6, "cut_out": 1, "cut_in": 1, "brake": 1},
    "rate": [0.0, 0.975],
} | {"runs": 2, "failed": 0, "forced": 0, "drawn": 1, "drawn_failed": 0}
RUN = {"act": "cut_out", "number": 1, "how": "drawn", "distance": 3.0, "outcome": "passed", "reason": ""}


def test_it_fits_a_narrow_window(chromium: Any, tmp_path: Path) -> None:
    """Nothing sticks out of its card: what is wider than the page is scrolled."""
    margins = {"bound": 6, "ego": "external", "policy": "litsim", "people": "people", "scenarios": [SCENARIO]}
    write_margins_page(margins, [[RUN, RUN | {"number": 2}]], tmp_path / "margins.html")
    assert "rule of three" not in (tmp_path / "margins.html").read_text(), "of one run it tells nothing"
    chromium.open(tmp_path / "margins.html", size=(480, 800))
    wider = "[...document.querySelectorAll('.card')].filter((card) => card.scrollWidth > card.clientWidth).length"
    assert chromium.run("document.querySelectorAll('.card').length") == 2
    assert chromium.run(wider) == 0
    assert chromium.problems == []
