"""What gets done in a second: programs are timed as they are, figures come from what they wrote, sides take turns."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from litsim_eval.benchmark import throughput
from litsim_eval.benchmark.throughput import (
    BESIDE,
    CPU,
    EVALUATE,
    FIGURES,
    HERE,
    ITERATIONS,
    RATIO,
    TRAIN,
    TRAINING,
    Side,
    generated_data,
    measure_throughput,
    throughput_rows,
    time_evaluation,
    time_training,
)
from litsim_sim.core.errors import InputError


class Told:
    """A side whose programs take two seconds, one of them of the processor, and write what they are told."""

    train = "litsim_research.policies.train"

    def __init__(self, name: str, content: object) -> None:
        self._name, self._content = name, content
        self.calls: list[tuple[str, ...]] = []

    def rates(self, module: str, *arguments: str, answers_no: bool = False) -> Callable[[str, float], dict[str, float]]:
        self.calls.append((module, *arguments))
        out = Path(arguments[arguments.index("--out") + 1])
        out.mkdir(parents=True, exist_ok=True)
        (out / self._name).write_text(json.dumps(self._content))
        return lambda figure, amount: {figure: amount / 2.0, figure + CPU: amount / 1.0}


def test_what_is_no_checkout_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a checkout of LitSim"):
        Side.beside(tmp_path)


def test_a_checkout_is_run_in_its_own_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "litsim"
    script.write_text(f'#!/bin/sh\nshift 2\nexec "{sys.executable}" "$@"\n')
    script.chmod(0o755)
    monkeypatch.setenv("PYTHONPATH", "/somewhere/else")
    side = Side.beside(tmp_path)
    assert "PYTHONPATH" not in side.environment


def test_scenario_seconds_are_those_of_the_runs_that_were_made(tmp_path: Path) -> None:
    side = Told("results.json", {"runs": [{"metrics": {"steps": steps}} for steps in (280, 120, 280)]})
    (tmp_path / "out").mkdir()
    (tmp_path / "out/results.json").write_text("of the turn before")
    found = time_evaluation(side, ["demo"], "3,7", 2, tmp_path / "out")
    assert found == {EVALUATE: pytest.approx(34.0), EVALUATE + CPU: pytest.approx(68.0)}
    (call,) = side.calls
    assert call[0] == "litsim_eval.cli.evaluate" and call[call.index("--ego-id") + 1] == "3,7"


def test_an_evaluation_whose_runs_do_not_pass_is_timed_all_the_same() -> None:
    words = ("timeit", "-n", "1", "-r", "1", "import os; os._exit(1)")
    assert Side.here().rates(*words, answers_no=True)("runs", 1.0)["runs"] > 0.0
    with pytest.raises(InputError, match="ended with status 1"):
        Side.here().rates(*words)


def test_agent_steps_are_those_of_the_iterations(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data/manifest.yaml").touch()
    history = [{"transitions": 100.0, "seconds": 0.5}, {"transitions": 200.0, "seconds": 0.5}]
    found = time_training(Told("history.json", history), tmp_path / "data", tmp_path / "out")
    assert found == {TRAIN: 150.0, TRAIN + CPU: 300.0, ITERATIONS: 300.0}
    assert (tmp_path / "out/data/manifest.yaml").is_file(), "nothing is generated within the time"


def test_each_checkout_trains_on_what_it_has_generated(tmp_path: Path) -> None:
    side = Told("data/manifest.yaml", {"written": "by its own program"})
    (tmp_path / "out/data").mkdir(parents=True)
    assert (generated_data(side, tmp_path / "out") / "manifest.yaml").is_file()
    (call,) = side.calls
    assert yaml.safe_load(Path(call[call.index("--config") + 1]).read_text()) == TRAINING


def test_sides_take_turns_and_ratios_are_those_of_pairs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    turns: list[str] = []
    here, there = Side.here(), Side(("other",), {})
    monkeypatch.setattr(Side, "beside", lambda _: there)
    monkeypatch.setattr(throughput, "generated_data", lambda *_: tmp_path)

    def evaluated(side: Side, *_: object) -> dict[str, float]:
        turns.append(HERE if side == here else BESIDE)
        rate = 6.0 if side == here else float(len(turns))
        return {EVALUATE: rate, EVALUATE + CPU: rate}

    monkeypatch.setattr(throughput, "time_evaluation", evaluated)
    monkeypatch.setattr(throughput, "time_training", lambda *_: {TRAIN: 1.0, TRAIN + CPU: 1.0, ITERATIONS: 1.0})
    found = measure_throughput(tmp_path, tmp_path, ["demo"], "egos", 2, 3, lambda: None)
    assert turns == [BESIDE, HERE, HERE, BESIDE, BESIDE, HERE]
    assert [sample[EVALUATE] for sample in found[RATIO]] == [6.0, 1.5, 1.2]
    rows = list(throughput_rows(found))
    assert [row[0] for row in rows] == list(FIGURES)
    assert rows[0][1:] == ["6.00 (6.00 to 6.00)", "4.00 (1.00 to 5.00)", "1.50 (1.20 to 6.00)"]
