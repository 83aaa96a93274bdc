"""Scenes as PNG and GIF, and the command line that asks for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from litsim_sim.analysis.run import Run
from litsim_sim.cli.report import main
from litsim_sim.errors import InputError
from litsim_sim.report.pictures import COLOURS, write_film, write_png
from litsim_sim.report.tracks import Mode


def has(picture: Image.Image, colour: str) -> bool:
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    pixels = np.asarray(picture.convert("RGB")).astype(int)[60:]  # below the legend
    return int((np.abs(pixels - wanted).max(axis=-1) <= 8).sum()) > 50


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


def test_gif(small_run: Run, tmp_path: Path) -> None:
    write_film(small_run, tmp_path / "film.gif", 20, 30, quiet=True)
    film = Image.open(tmp_path / "film.gif")
    assert getattr(film, "n_frames", 1) == 6
    assert film.info["duration"] == 200


@pytest.mark.parametrize(("first", "last"), [(0, 99), (-1, 5), (9, 5)])
def test_steps_that_are_not_there(first: int, last: int, small_run: Run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="step"):
        write_film(small_run, tmp_path / "film.gif", first, last, quiet=True)


def test_mp4_needs_ffmpeg(small_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(InputError, match="ffmpeg"):
        write_film(small_run, tmp_path / "film.mp4", quiet=True)


@pytest.mark.parametrize("words", [[], ["bag", "--experiment", "x"], ["nowhere"], ["bag", "--png", "a.jpg"]])
def test_command_line_says_what_is_wrong(words: list[str], capsys: Any) -> None:
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2
    assert "error" in capsys.readouterr().err


def test_command_line_writes(small_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    read: Callable[[Path], Run] = lambda path: small_run  # noqa: E731
    monkeypatch.setattr("litsim_sim.analysis.run.read_run", read)
    main(["bag", "--png", str(tmp_path / "scene.png")])
    assert (tmp_path / "scene.png").is_file()
    assert "scene.png" in capsys.readouterr().out
