"""`tools/figures.py`: figures that are older than their inputs are named, until they are stamped."""

import subprocess
import sys
from pathlib import Path

import pytest

from programs import program

TOOL = Path(__file__).parents[2] / "tools/figures.py"
figures = program("tools/figures.py")

PAGE = """# Page

<!-- begin: figures ./litsim score; inputs: src/**/*.yaml src/weights; digest: 0 -->
| 1 |
<!-- end: figures -->
<!-- begin: figures make bench; inputs: src/*/b.yaml -->
| 2 |
<!-- end: figures -->
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name in ("src/x/a.yaml", "src/y/b.yaml", "src/weights"):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(name)
    (tmp_path / "page.md").write_text(PAGE)
    return tmp_path


def faults(root: Path) -> list[str]:
    return list(figures.faults(root, root / "page.md"))


def test_figures_are_old_until_they_are_stamped_and_again_when_an_input_changes(root: Path) -> None:
    score, bench = faults(root)
    assert score.startswith("page.md: figures of `./litsim score`: older than their inputs (digest 0, today ")
    assert "figures of `make bench`" in bench
    assert figures.stamp(root, root / "page.md") == 2
    assert faults(root) == []
    (root / "src/x/a.yaml").write_text("other")
    assert [text.split("`")[1] for text in faults(root)] == ["./litsim score"]
    assert "| 1 |" in (root / "page.md").read_text()


def test_only_the_command_that_was_run_again_is_stamped(root: Path) -> None:
    assert figures.stamp(root, root / "page.md", "bench") == 1
    assert [text.split("`")[1] for text in faults(root)] == ["./litsim score"]


def test_moved_inputs_have_the_same_digest(root: Path) -> None:
    before = figures.digest(root, "src/**/*.yaml")
    (root / "src/x").rename(root / "src/renamed")
    assert figures.digest(root, "src/**/*.yaml") == before


def test_a_glob_that_matches_nothing_is_named(root: Path) -> None:
    (root / "src/weights").unlink()
    assert faults(root)[0] == "page.md: figures of `./litsim score`: inputs: src/weights: matches no file"


@pytest.mark.parametrize("broken", ["<!-- begin: figures ./litsim score -->", "<!-- end: figures -->"])
def test_marks_without_inputs_or_without_an_end_are_named(root: Path, broken: str) -> None:
    figures.stamp(root, root / "page.md")
    with (root / "page.md").open("a") as stream:
        stream.write(f"{broken}\n")
    (fault,) = faults(root)
    assert "as many marks" in fault


def test_the_documentation_is_not_older_than_what_makes_it() -> None:
    done = subprocess.run([sys.executable, TOOL, "--check"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
