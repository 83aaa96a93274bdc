"""Scenes as PNG, and the command line that asks for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from litsim_eval.cli.report import main
from litsim_eval.report.pictures import write_png
from litsim_sim.core.colours import COLOURS, Mode
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.record.run import Run


def has(picture: Image.Image, colour: str, tolerance: int = 8) -> bool:
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    pixels = np.asarray(picture.convert("RGB")).astype(int)[60:]  # below the legend
    return int((np.abs(pixels - wanted).max(axis=-1) <= tolerance).sum()) > 50


def test_png(small_run: Run, tmp_path: Path) -> None:
    shown = {}
    for step in (5, 30, 40):
        write_png(small_run, step, tmp_path / "scene.png")
        picture = Image.open(tmp_path / "scene.png")
        assert picture.size == (1280, 480)
        shown[step] = {mode for mode, (colour, _) in COLOURS.items() if has(picture, colour)}
    assert shown[5] == {Mode.EGO, Mode.LOG}
    assert shown[30] == {Mode.EGO, Mode.LOG, Mode.POLICY}
    assert shown[40] == {Mode.EGO, Mode.LOG, Mode.HANDBACK}


def test_pedestrians_are_round(small_run: Run, tmp_path: Path) -> None:
    """As many pixels of its colour as an ellipse has of its box, the ego being drawn as one."""
    shown = []
    for kind in (Kind.CAR, Kind.PEDESTRIAN):
        tables = [
            replace(t, kind=np.where(t.id == small_run.info.ego_id, kind, t.kind).astype(np.uint8))
            for t in small_run.tables
        ]
        write_png(replace(small_run, tables=tables), 5, tmp_path / "scene.png")
        wanted = [int(COLOURS[Mode.EGO][0][i : i + 2], 16) for i in (1, 3, 5)]
        pixels = np.asarray(Image.open(tmp_path / "scene.png").convert("RGB")).astype(int)[60:]
        shown.append(int((np.abs(pixels - wanted).max(axis=-1) <= 8).sum()))
    assert 0.65 < shown[1] / shown[0] < 0.9


@pytest.mark.parametrize("step", [-1, 99])
def test_steps_that_are_not_there(step: int, small_run: Run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="step"):
        write_png(small_run, step, tmp_path / "scene.png")


@pytest.mark.parametrize("words", [[], ["bag", "--experiment", "x"], ["nowhere"], ["bag", "--png", "a.jpg"]])
def test_command_line_says_what_is_wrong(words: list[str], capsys: Any) -> None:
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2
    assert "error" in capsys.readouterr().err


def test_command_line_writes(small_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    read: Callable[[Path], Run] = lambda path: small_run  # noqa: E731
    monkeypatch.setattr("litsim_sim.record.run.read_run", read)
    main(["bag", "--png", str(tmp_path / "scene.png")])
    assert (tmp_path / "scene.png").is_file()
    assert "scene.png" in capsys.readouterr().out
