"""A checkout that was copied, with what was built in the original: its scripts name the original's environment."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A folder with the scripts that begin runs and builds, and with an install/ whose setup files name `ROOT`."""
    (tmp_path / "install").mkdir()
    for file in ("litsim", "tools/build.sh", "install/setup.sh", "install/setup.bash"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / file, tmp_path / file)
    return tmp_path


def test_a_run_from_a_copy_does_not_use_the_original(copied: Path) -> None:
    run = subprocess.run(["./litsim", "exec", "true"], cwd=copied, capture_output=True, text=True, check=False)
    assert run.returncode == 2 and "this checkout is a copy" in run.stderr
    assert subprocess.run([ROOT / "litsim", "exec", "true"], check=False).returncode == 0


def test_a_build_in_a_copy_begins_anew(copied: Path) -> None:
    build = subprocess.run(["tools/build.sh"], cwd=copied, capture_output=True, text=True, check=False)
    assert "made anew" in build.stdout and not (copied / "install").exists()
    assert build.returncode != 0, "there is no environment to build on"
