"""The notebook of the first run: its cells run one after the other, and show what they say."""

import json
from contextlib import chdir
from typing import Any

import matplotlib as mpl
import pytest
from PIL import Image

from documentation import ROOT

NOTEBOOK = json.loads((ROOT / "examples/first_run.ipynb").read_text())


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the notebook has defined at its end, and the folder in which it has run."""
    mpl.use("Agg")
    defined: dict[str, Any] = {"__name__": "notebook", "folder": tmp_path_factory.mktemp("notebook")}
    with chdir(defined["folder"]):
        for cell in NOTEBOOK["cells"]:
            if cell["cell_type"] == "code":
                exec("".join(cell["source"]), defined)
    return defined


def test_policies_take_agents_over_and_replay_lets_them_collide(names: dict[str, Any]) -> None:
    most = {name: max(counts) for name, counts in names["controlled"].items()}
    assert most["replay"] == 0 and most["litsim"] > 0 and most["my own"] > 0
    assert names["contacts"]["replay"] > max(names["contacts"]["litsim"], names["contacts"]["my own"])


def test_the_plot_has_a_line_for_each_policy(names: dict[str, Any]) -> None:
    assert len(names["axes"].get_lines()) == len(names["controlled"]) == 3


def test_the_last_run_is_a_moving_picture(names: dict[str, Any]) -> None:
    with Image.open(names["folder"] / "first_run.webp") as picture:
        assert picture.n_frames == 30


def test_no_output_is_kept() -> None:
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in NOTEBOOK["cells"])
