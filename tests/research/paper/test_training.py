"""`paper train --quick`: both networks are made, interruptions are resumed, and what is finished is kept."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from command_line import refusal
from litsim_policy.driving.policy_network import PolicyNetwork
from litsim_predictor.inference.weights import read_weights
from litsim_research.cli.paper import main
from litsim_research.paper.training import POLICY, PREDICTOR, QUICK, Job, jobs

PROGRAM = "from litsim_research.cli.paper import main; main()"


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "train" / "trainings.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_trial_makes_both_and_goes_on_where_it_was_interrupted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["train", "--quick", "--seeds", "4", "--processes", "1", "--out", str(tmp_path)]
    folder = tmp_path / "train"
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, *command], stderr=subprocess.PIPE, text=True)
    begun = time.monotonic()
    while not (folder / "policy_4" / "log.txt").is_file() and time.monotonic() - begun < 60:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    assert "the same command continues" in process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert not any(is_running(folder / "policy_4"))
    assert float(json.loads((folder / "policy_4" / "seconds.json").read_text())) > 0.0

    main(command)
    said = capsys.readouterr().out
    assert f"policy.weights={folder}/policy_4/best.safetensors" in said and "predictor.model=" in said
    made = {row["what"]: row for row in rows(tmp_path)}
    assert {what: (row["seed"], row["done"], row["of"]) for what, row in made.items()} == {
        PREDICTOR: ("4", "1", "1"),
        POLICY: ("4", "1", "1"),
    }
    assert int(made["policy"]["agent_steps"]) >= QUICK[POLICY]["transitions"]
    PolicyNetwork.load(folder / "policy_4" / "best.safetensors")
    assert read_weights(str(folder / "predictor_4" / "weights.safetensors"))

    before = (folder / "policy_4" / "best.safetensors").stat().st_mtime_ns, rows(tmp_path)
    main(command)
    assert "policy, seed 4: 1 of 1 iterations are done" in capsys.readouterr().out
    assert before == ((folder / "policy_4" / "best.safetensors").stat().st_mtime_ns, rows(tmp_path))


def is_running(folder: Path) -> list[int]:
    """Process ids of trainings into `folder`."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if str(folder).encode() in (entry / "cmdline").read_bytes() and int(entry.name) != os.getpid():
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def test_a_training_that_fails_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(QUICK[POLICY], "iterations", 0)
    said = refusal(capsys, main, "train", "--quick", "--seeds", 0, "--out", tmp_path)
    assert "train/policy_0/log.txt: the training failed" in said and "iterations" in said


def test_trainings_are_those_of_the_packaged_configurations(tmp_path: Path) -> None:
    wanted = jobs(tmp_path, [2, 0, 2], quick=False)
    assert [(job.what, job.seed) for job in wanted] == [(POLICY, 2), (POLICY, 0), (PREDICTOR, 2), (PREDICTOR, 0)]
    config = Job(PREDICTOR, 2, tmp_path, quick=False).config
    assert (config["learning_rate"], config["divided_every"], config["seed"]) == (0.001, 10, 2)
    assert "teachers" not in config
    assert Job(POLICY, 2, tmp_path, quick=False).config["data"]["following"] is True
