"""Clips: pictures in turn of runs one below the other, in which whoever has run into another keeps a coloured edge."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from litsim_eval.cli.report import main
from litsim_eval.pictures.clip import write_clip
from litsim_sim.core.colours import CONFLICT
from litsim_sim.core.scene import Controller
from litsim_sim.record.run import Run
from made_runs import make_run

Make = Callable[..., Any]


@pytest.fixture
def runs(agent_table: Make) -> tuple[Run, Run]:
    """An ego, 1, that stands from 40 m on, and an agent that drives on into it, or stops 10 m before it."""

    def run(end: float) -> Run:
        ego = {"id": 1, "x": 40.0, "controller": Controller.EGO}
        steps = [min(end, 1.0 * step) for step in range(60)]
        tables = [agent_table(k, ego, {"id": 2, "x": x, "speed": 10.0}) for k, x in enumerate(steps)]
        log = [agent_table(k, {"id": 1, "x": 90.0}, {"id": 2, "x": x}) for k, x in enumerate(steps)]
        return make_run(tables, log, history_steps=10)

    return run(60.0), run(30.0)


def coloured(picture: Image.Image, colour: str) -> int:
    """Returns the number of pixels of a colour."""
    away = np.abs(np.asarray(picture.convert("RGB"), float) - 255.0 * np.array(to_rgb(colour)))
    return int((away.max(axis=-1) < 12.0).sum())


def test_whoever_runs_into_another_is_marked_from_then_on(
    runs: tuple[Run, Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("litsim_eval.pictures.clip.EVERY_S", 1.0)
    heights = []
    for name, shown in (("both", runs), ("apart", runs[1:])):
        write_clip(shown, tmp_path / f"{name}.png")
        with Image.open(tmp_path / f"{name}.png") as clip:
            assert clip.n_frames > 3
            heights.append(clip.height)
            first = coloured(clip, CONFLICT)
            clip.seek(clip.n_frames - 1)
            last = coloured(clip, CONFLICT)
        assert first == 0 and (last > 100) == (name == "both")
    assert heights[0] > 1.5 * heights[1], "one below the other"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--clip", "clip.mp4"], "expected a name that ends in .webp, .gif, .png"),
        (["again"], "expected one run, or --clip"),
    ],
)
def test_what_cannot_be_drawn_is_refused(
    arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main([str(Path(__file__).parents[2] / "sim/record/bags/format_1"), *arguments])
    assert expected in capsys.readouterr().err
