"""Learning curves: every entry where it was measured."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from litsim_research.policies.plots import PANELS, SIMNET_PANELS
from litsim_research.predictors.training.curves import plot_curves


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures that have been drawn."""
    figures: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: figures.append(self) or save(self, *a, **k))
    return figures


def test_validations_are_drawn_where_they_were_made(tmp_path: Path, drawn: list[Figure]) -> None:
    usual = {name: 0.5 for lines in PANELS.values() for name in lines if not name.startswith("validation")}
    history = [usual, usual | {"validation_penalty": 0.25}, usual]
    plot_curves(history, tmp_path / "curves.png", PANELS)
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    (figure,) = drawn
    assert [axis.get_title() for axis in figure.axes] == list(PANELS)
    lines = {line.get_label(): line.get_xydata().tolist() for line in figure.axes[0].lines}
    assert lines == {"training": [[0, 0.5], [1, 0.5], [2, 0.5]], "validation": [[1, 0.25]]}


def test_what_was_not_measured_is_not_drawn(tmp_path: Path, drawn: list[Figure]) -> None:
    """A training without a critic used to have two empty panels."""
    history = [{"penalty": -0.5, "collisions": 1.0, "off_road": 0.0, "guard": 0.1}] * 2
    plot_curves(history, tmp_path / "curves.png", PANELS)
    assert [axis.get_title() for axis in drawn[0].axes] == [
        title for title in PANELS if "guard" in title or "1000" in title or "penalty" in title
    ]


def test_curves_along_what_was_learned(tmp_path: Path, drawn: list[Figure]) -> None:
    names = [name for lines in SIMNET_PANELS.values() for name in lines]
    history = [{"batches": 500.0 * k} | dict.fromkeys(names, 10.0**-k) for k in (1, 2)]
    plot_curves(history, tmp_path / "curves.png", SIMNET_PANELS, along="batches", log=True)
    (figure,) = drawn
    assert figure.axes[-1].get_xlabel() == "batches" and figure.axes[0].get_yscale() == "log"
    assert figure.axes[1].lines[0].get_xydata().tolist() == [[500, 0.1], [1000, 0.01]]
