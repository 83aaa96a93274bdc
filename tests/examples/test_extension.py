"""A package outside of the tree adds a plug-in of each kind, without an edit to LitSim."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from campaigns import scenario_file
from litsim_sim.launch.nodes import find_executable
from litsim_sim.scenario.recording import Recording

ROOT = Path(__file__).resolve().parents[2]
EXTENSION = ROOT / "examples/extension"
POLICY, MEASURE, FORMAT = "keep_gap", "closest", "tracks_json"


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment with the package installed into a folder of its own, by pip and without a network."""
    folder = tmp_path_factory.mktemp("site")
    source = folder.with_name("source")
    subprocess.run(["cp", "-r", str(EXTENSION), str(source)], check=True)  # pip builds in the folder of the source
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*install, "--target", str(folder), str(source)], check=True)
    return os.environ | {"PYTHONPATH": f"{folder}:{os.environ.get('PYTHONPATH', '')}"}


def verb(extended: dict[str, str], package: str, name: str, *words: object) -> subprocess.CompletedProcess[str]:
    """A finished program of LitSim, beside the package."""
    command = [str(find_executable(package, name)), *map(str, words)]
    return subprocess.run(command, env=extended, capture_output=True, text=True, check=False)


def test_campaign_by_the_policy_judged_by_the_measure(extended: dict[str, str], tmp_path: Path) -> None:
    criteria, out = tmp_path / "criteria.yaml", tmp_path / "campaign"
    criteria.write_text(f"runs:\n  - {{name: keeps away, field: added.{MEASURE}, min: 0.5}}\n")
    words = ("--scenario", "demo", "--ego-id", "6", "--policy", POLICY, "replay", "--criteria", criteria, "--out", out)
    done = verb(extended, "litsim_eval", "evaluate", *words, "--set", f"policy.{POLICY}.time_gap=1.2")
    assert done.returncode == 1, done.stderr  # replay drives into the ego, and does not keep away
    assert "ego: closest centre [m] ↑" in done.stdout
    runs: list[dict[str, Any]] = json.loads((out / "results.json").read_text())["runs"]
    assert [run["verdict"] for run in runs if run["case"]["policy"] == POLICY] == ["passed"]
    assert [run["verdict"] for run in runs if run["case"]["policy"] == "replay"] == ["failed"]
    for run in runs:
        (criterion,) = run["criteria"]
        assert criterion["value"] == run["metrics"]["added"][MEASURE]
        assert (run["metrics"]["takeovers"] > 0) == (run["case"]["policy"] == POLICY), (
            "of the region, as the policy says"
        )
    assert MEASURE in (out / "experiment.html").read_text()


def test_over_the_graph_as_in_process(extended: dict[str, str], tmp_path: Path) -> None:
    out, words = tmp_path / "run", ("--scenario", scenario_file(tmp_path, simulation_s=8.0), "--policy", POLICY)
    done = verb(extended, "litsim_sim", "launch", *words, "--quiet", "--out", out)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["takeovers"] > 0
    alone = verb(extended, "litsim_eval", "run", *words)
    assert metrics["digest"][:16] in alone.stdout
    assert f"{metrics['added'][MEASURE]:.2f} m" in alone.stdout


def test_recording_in_the_format(extended: dict[str, str], tmp_path: Path) -> None:
    rows = [
        [vehicle, frame, 100.0 + 20 * vehicle + frame, -9.15, 0.0, 10.0] for vehicle in (1, 2) for frame in range(50)
    ]
    source, out = tmp_path / "mine.json", tmp_path / "mine.parquet"
    source.write_text(json.dumps({"tracks": rows}))
    done = verb(extended, "litsim_data", "data", "convert", source, out)
    assert done.returncode == 0, done.stderr
    recording = Recording.read(out)
    assert len(recording.columns["x"]) == len(rows) and recording.header.source == FORMAT


def test_its_own_tests_pass(extended: dict[str, str], netconvert: None) -> None:
    words = ("-m", "pytest", "-q", "-p", "no:cacheprovider", EXTENSION / "test_example.py")
    done = subprocess.run([sys.executable, *words], env=extended, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "6 passed" in done.stdout, done.stdout


def test_help_lists_what_is_installed(extended: dict[str, str]) -> None:
    assert POLICY in verb(extended, "litsim_sim", "launch", "--help").stdout


def test_two_plugins_of_one_name_are_refused(extended: dict[str, str], tmp_path: Path) -> None:
    other = tmp_path / "other-1.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1\n")
    (other / "entry_points.txt").write_text(f"[litsim.policies]\n{POLICY} = other:Policy\n")
    beside = extended | {"PYTHONPATH": f"{tmp_path}:{extended['PYTHONPATH']}"}
    done = verb(beside, "litsim_eval", "run", "--policy", POLICY)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert f"two plug-ins of litsim.policies are called {POLICY}" in line
    assert "other:Policy of other" in line and "KeepGap of litsim-example" in line
