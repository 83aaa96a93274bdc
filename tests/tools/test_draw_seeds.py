"""`tools/draw_seeds.py`: fresh seeds for the commit at hand, and none while there are changes beside it."""

import json
import subprocess
from pathlib import Path

import pytest

from programs import program

tool = program("tools/draw_seeds.py")


def test_seeds_are_drawn_for_a_commit_and_only_for_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {"commit": "", "paper": [1, 2], "left_turns": 3}
    file = tmp_path / "reported.json"
    file.write_text(json.dumps(before))
    identity = ("-c", "user.name=a", "-c", "user.email=a@b.example")
    for words in (["init", "-q"], ["add", "."], [*identity, "commit", "-qm", "first"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    monkeypatch.setattr(tool, "ROOT", tmp_path)
    monkeypatch.setattr(tool, "FILE", file)
    assert tool.main() == 0
    drawn = json.loads(file.read_text())
    seeds = [*drawn["paper"], drawn["left_turns"], drawn["freeways"]]
    assert drawn["commit"] == tool.git("rev-parse", "HEAD")
    assert len(set(seeds)) == 7 and min(seeds) >= tool.LOWEST
    assert tool.main() == 1, "the drawn seeds are not committed"
    assert "not committed" in capsys.readouterr().err and json.loads(file.read_text()) == drawn


def test_no_seed_comes_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    draws = iter([0, 1, 1, 2, 3, 4, 5, 6, 7, 8, 9])
    monkeypatch.setattr(tool.secrets, "randbelow", lambda count: next(draws))
    content = tool.drawn("c", {"paper": [tool.LOWEST], "left_turns": tool.LOWEST + 5})
    assert [*content["paper"], content["left_turns"]] == [tool.LOWEST + k for k in (1, 2, 3, 4, 6, 7)]
