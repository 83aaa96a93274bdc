"""From a data set as it is published to a verdict on a driving system, in two commands."""

import json
import os
import subprocess
from pathlib import Path

import pytest

import made_sources

ROOT = Path(__file__).resolve().parents[2]
EVALUATE = (
    "evaluate --scenario mine/scenarios/*_train_*.yaml --ego-id ego --ego external --policy litsim --out campaign "
    "-- python3 examples/minimal_ads.py"
)


@pytest.mark.graph
@pytest.mark.usefixtures("netconvert")
def test_two_commands_from_a_download_to_a_verdict(tmp_path: Path) -> None:
    made_sources.argoverse(tmp_path / "download")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for command in ("data import download mine", EVALUATE):
        done = subprocess.run(
            ["bash", "-c", f"{ROOT}/litsim {command}"],
            cwd=tmp_path,
            env=os.environ,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode in ((0,) if command.startswith("data") else (0, 1)), done.stdout + done.stderr
    (run,) = json.loads((tmp_path / "campaign" / "results.json").read_text())["runs"]
    assert run["verdict"] in ("passed", "failed"), run
    assert run["metrics"]["ego_motion"]["progress_m"] > 30.0, "it drives along the imported road"
