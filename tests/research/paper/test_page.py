"""Marked parts of a page are filled, and nothing else is touched."""

from __future__ import annotations

from pathlib import Path

import pytest

from litsim_research.paper.page import fill, marks
from litsim_sim.core.errors import InputError


def page(folder: Path) -> Path:
    path = folder / "results.md"
    parts = ["# Results", *marks("table"), "by hand", *marks("ablation"), "the end\n"]
    path.write_text("\n".join(parts))
    return path


def test_a_part_is_filled_again_and_again(tmp_path: Path) -> None:
    path = page(tmp_path)
    fill(path, "ablation", ["| a\\d |", "| 1 |"])
    fill(path, "table", ["x", "y"])
    fill(path, "table", ["z"])
    begin, end = marks("table")
    assert path.read_text().split("\n") == [
        "# Results", begin, "z", end, "by hand", marks("ablation")[0], "| a\\d |", "| 1 |", marks("ablation")[1],
        "the end", "",
    ]  # fmt: skip


def test_a_page_without_the_marks(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected lines <!-- begin: paper times -->"):
        fill(page(tmp_path), "times", ["x"])


def test_the_page_of_the_documentation_has_all_parts() -> None:
    text = (Path(__file__).parents[3] / "docs/results.md").read_text()
    for name in ("table", "ablation", "oracles", "sanity", "figures", "times"):
        assert all(text.count(mark) == 1 for mark in marks(name)), name
