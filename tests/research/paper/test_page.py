"""Marked parts of a page are filled, and nothing else is touched."""

from pathlib import Path

import pytest

from litsim_research.cli.paper import FIGURES, SHOWN
from litsim_research.paper.page import END, begin, fill
from litsim_sim.core.errors import InputError

STAMPED = "<!-- begin: figures paper ablation; inputs: src/*.py; digest: 12ab -->"


def page(folder: Path) -> Path:
    path = folder / "results.md"
    parts = ["# Results", begin("paper table"), END, "by hand", STAMPED, "old", END, "the end\n"]
    path.write_text("\n".join(parts))
    return path


def test_a_part_is_filled_again_and_again(tmp_path: Path) -> None:
    path = page(tmp_path)
    fill(path, "paper ablation", ["| a\\d |", "| 1 |"])
    fill(path, "paper table", ["x", "y"])
    fill(path, "paper table", ["z"])
    assert path.read_text().split("\n") == [
        "# Results", begin("paper table"), "z", END, "by hand", STAMPED, "| a\\d |", "| 1 |", END, "the end", "",
    ]  # fmt: skip


def test_a_page_without_the_marks(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected lines <!-- begin: figures paper goals -->"):
        fill(page(tmp_path), "paper goals", ["x"])


def test_the_page_of_the_documentation_has_all_parts() -> None:
    text = (Path(__file__).parents[3] / "docs/results.md").read_text()
    for name in (*SHOWN, FIGURES):
        assert text.count(begin(f"paper {name}").removesuffix(" -->")) == 1, name
