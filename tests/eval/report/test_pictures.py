"""Scenes as PNG and GIF, and the command line that asks for them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from litsim_eval.cli.report import main
from litsim_eval.report.pictures import _ffmpeg, write_film, write_png
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


def test_gif(small_run: Run, tmp_path: Path) -> None:
    write_film(small_run, tmp_path / "film.gif", 20, 30, quiet=True)
    film = Image.open(tmp_path / "film.gif")
    assert getattr(film, "n_frames", 1) == 6
    assert film.info["duration"] == 200


@pytest.mark.parametrize(("first", "last"), [(0, 99), (-1, 5), (9, 5)])
def test_steps_that_are_not_there(first: int, last: int, small_run: Run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="step"):
        write_film(small_run, tmp_path / "film.gif", first, last, quiet=True)


def test_mp4(small_run: Run, tmp_path: Path) -> None:
    try:
        program = _ffmpeg(tmp_path / "film.mp4")
    except InputError as error:
        pytest.skip(str(error))
    write_film(small_run, tmp_path / "film.mp4", 20, 40, quiet=True)
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
    decode = [program, "-nostdin", "-i", str(tmp_path / "film.mp4"), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(decode, capture_output=True, check=True)
    frames = np.frombuffer(done.stdout, np.uint8).reshape(-1, 480, 1280, 3)
    assert len(frames) == 11
    assert "Duration: 00:00:02.20" in done.stderr.decode()
    assert "h264" in done.stderr.decode()
    for frame, modes in ((0, {Mode.EGO, Mode.LOG, Mode.POLICY}), (10, {Mode.EGO, Mode.LOG, Mode.HANDBACK})):
        picture = Image.fromarray(frames[frame])
        assert {mode for mode, (colour, _) in COLOURS.items() if has(picture, colour, 30)} == modes  # lossy


def test_mp4_needs_ffmpeg(small_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"film.mp4: an MP4 needs ffmpeg, .*pip install imageio-ffmpeg"):
        write_film(small_run, tmp_path / "film.mp4", quiet=True)


def test_ffmpeg_that_fails_is_named_and_leaves_nothing(
    small_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\ncat >/dev/null\nexit 7\n")
    broken.chmod(0o755)
    monkeypatch.setattr("shutil.which", lambda name: str(broken))
    with pytest.raises(InputError, match=r"film.mp4: cannot be written: .*ffmpeg ended with exit status 7"):
        write_film(small_run, tmp_path / "film.mp4", 20, 24, quiet=True)
    assert list(tmp_path.iterdir()) == [broken]


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
