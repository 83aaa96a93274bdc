"""The evaluation from files to its table, JSON, CSV and picture."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from command_line import refusal, status
from litsim_predictor.inference import SHIPPED
from litsim_research.cli.score import evaluate, main, parser
from litsim_research.predictors.evaluation.evaluation import COMPARED, load_models
from litsim_research.predictors.models import weights
from litsim_research.predictors.models.registry import build
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.recording import Recording, RecordingHeader

LAST = 90  # step: 9 s, of which 3.0 to 4.0 s can be scored: 6 scenes
SCENES = 6
NAMES = ["constant_velocity", "kinematic"]
SECONDS = ["1", "2", "3", "4", "5"]

Write = Callable[..., Path]


@pytest.fixture
def write(track: Any, tmp_path: Path) -> Write:
    """Writes a recording of cars in line, one for each acceleration, on the net that `net` names."""

    def build_file(*accelerations: float, last: int = LAST, net: str = "us101_like", name: str = "made") -> Path:
        rows = [
            track(k + 1, x=10.0 + 20.0 * k, speed=10.0, acceleration=acceleration, last=last).rows()
            for k, acceleration in enumerate(accelerations)
        ]
        path = tmp_path / f"{name}.parquet"
        header = RecordingHeader("made", net=net)
        Recording.from_table(header, pd.concat(rows, ignore_index=True), name).write(path)
        return path

    return build_file


@pytest.fixture(scope="module")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of weights that nobody trained."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "untrained.safetensors"
    weights.save_model(build("cs_lstm", {}, "test"), weights.Provenance("cs_lstm", {}, "", {}, {}, {}), path)
    return path


def measure(*words: str | Path) -> dict[str, dict[str, Any]]:
    models = () if "--models" in words else ("--models", *NAMES)
    return evaluate(parser().parse_args([str(word) for word in (*models, *words)]))


# Measures


def test_constant_velocity_is_off_by_half_the_acceleration_times_the_square_of_time(write: Write) -> None:
    scores = measure("--recording", write(0.4, 0.4))
    assert list(scores) == NAMES
    measures = scores["constant_velocity"]
    assert (measures["samples"], measures["scenes"]) == (2 * SCENES, SCENES)
    assert list(measures["rmse"]) == SECONDS
    assert list(measures["rmse"].values()) == pytest.approx([0.2, 0.8, 1.8, 3.2, 5.0], abs=1e-3)
    t = 0.2 * np.arange(1, 26)
    for name in ("ade", "min_ade", "joint_ade"):
        assert measures[name] == pytest.approx(0.2 * (t**2).mean(), abs=1e-3)
    assert measures["ratio_to_constant_velocity"] == dict.fromkeys(SECONDS, 1.0)
    assert measures["overlap_rate"] == measures["overlap_rate_truth"] == 0.0
    assert "conflicts" not in measures


def test_where_constant_velocity_is_right_there_is_no_ratio_to_it(write: Write) -> None:
    # At rest it is right to the last bit.
    path = write(0.0)
    table = Recording.read(path).table
    table["x"], table["speed"] = 50.0, 0.0
    Recording.from_table(RecordingHeader("rest", net="us101_like"), table, "rest").write(path)
    scores = measure("--recording", path)["kinematic"]
    assert scores["rmse"] == dict.fromkeys(SECONDS, 0.0)
    assert scores["ratio_to_constant_velocity"] == dict.fromkeys(SECONDS)


def test_several_recordings_are_scored_as_one(write: Write) -> None:
    slow, fast = write(0.2, name="slow"), write(0.4, name="fast")
    scores = measure("--recording", slow, fast)["constant_velocity"]
    assert (scores["samples"], scores["protocol"]["sources"]) == (2 * SCENES, ["slow", "fast"])
    assert scores["rmse"]["5"] == pytest.approx(np.sqrt(0.5 * (2.5**2 + 5.0**2)), abs=1e-3)


def test_a_split_scores_the_vehicles_of_its_part(write: Write) -> None:
    path = write(*[0.0] * 9, 0.2, *[0.4] * 3)
    rmse = {"train": (9, 0.0), "val": (1, 2.5), "test": (3, 5.0)}
    for part, (vehicles, at_5) in rmse.items():
        scores = measure("--recording", path, "--split", part)["constant_velocity"]
        assert scores["samples"] == vehicles * SCENES
        assert scores["rmse"]["5"] == pytest.approx(at_5, abs=1e-3)


def test_stride_is_the_time_between_scenes(write: Write) -> None:
    assert measure("--recording", write(0.0), "--stride", "10")["kinematic"]["scenes"] == 2  # at 3 and 4 s


def test_of_a_region_of_interest_nothing_beyond_is_seen(write: Write, untrained: Path) -> None:
    """Cars 20 m apart: within 10 m everybody is alone, within 1 km there is what there is without a region."""
    line, alone = write(0.0, 0.0, 0.0), write(0.0, name="alone")
    everything, narrow, wide = (
        measure(untrained, "--recording", line, "--roi", m)[str(untrained)] for m in (0, 10, 1000)
    )
    assert narrow["protocol"]["roi_m"] == 10.0 and everything["protocol"]["roi_m"] is None
    assert (narrow["samples"], narrow["scenes"]) == (3 * SCENES, 3 * SCENES)
    assert wide["rmse"] == pytest.approx(everything["rmse"], rel=1e-4)
    assert narrow["rmse"]["5"] != pytest.approx(everything["rmse"]["5"], rel=1e-3)
    one = measure(untrained, "--recording", alone)[str(untrained)]
    assert narrow["nll"] == pytest.approx(one["nll"], rel=1e-2)
    with pytest.raises(InputError, match="expected 0 or more metres"):
        measure("--recording", line, "--roi", "-1")


def test_any_file_of_weights_is_a_model_and_answers_are_the_same_again(write: Write, untrained: Path) -> None:
    path = write(0.4, -0.3)
    once, again = (measure(untrained, "--recording", path) for _ in range(2))
    assert once == again
    scores = once[str(untrained)]
    assert scores["min_ade"] < scores["joint_ade"] < scores["ade"]
    by_batch = measure(untrained, "--recording", path, "--batch", "1")[str(untrained)]
    for name in ("nll", "ade", "min_ade", "joint_ade"):
        assert by_batch[name] == pytest.approx(scores[name], rel=1e-4)


def test_a_scenario_is_evaluated_with_conflicts(make_scenario: Callable[..., Any], track: Any) -> None:
    scenario = make_scenario(
        track(1, x=20.0, speed=10.0, last=120), track(2, x=100.0, speed=0.0, last=120), history_steps=30
    )
    path = Path(scenario.file.recording).with_name("made.yaml")
    scores = measure("--scenario", path)
    assert scores["constant_velocity"]["conflicts_by_drive"]["keeps_speed"]["1"]["recall"] == 1.0
    of_kinds = scores["constant_velocity"]["conflicts_by_drive"].values()
    for second, counts in scores["constant_velocity"]["conflicts"].items():
        for name in ("predicted", "real", "pairs"):
            assert counts[name] == sum(kind[second][name] for kind in of_kinds)
    assert "conflicts" not in measure("--scenario", path, "--egos", "none")["constant_velocity"]


# Maps


def test_without_a_net_the_map_is_empty(write: Write, untrained: Path) -> None:
    with_map = measure(untrained, "--recording", write(0.4))
    without = measure(untrained, "--recording", write(0.4, net=""))
    assert without["constant_velocity"]["rmse"] == pytest.approx(with_map["constant_velocity"]["rmse"], abs=1e-3)
    given = measure(untrained, "--recording", write(0.4, net=""), "--net", "us101_like")
    for measures in (with_map, given, without):
        for name in measures.values():
            name["protocol"] = None
    assert given == with_map


def test_a_net_that_is_not_there_is_reported_and_done_without(write: Write, caplog: Any) -> None:
    scores = measure("--recording", write(0.4, net="lost.net.xml"))
    assert "lost.net.xml" in caplog.text
    assert scores["constant_velocity"]["samples"] == SCENES


def test_a_net_that_was_asked_for_must_be_there(write: Write) -> None:
    with pytest.raises(InputError, match=r"lost\.net\.xml"):
        measure("--recording", write(0.4), "--net", "lost.net.xml")


# Outputs


def test_the_command_writes_json_and_a_picture_and_prints_the_table(write: Write, tmp_path: Path, capsys: Any) -> None:
    out, picture = tmp_path / "out.json", tmp_path / "out.png"
    status(main, "--models", "kinematic", "--recording", write(0.4), "--json", out, "--plot", picture)
    scores = json.loads(out.read_text())
    assert set(scores) == {"constant_velocity", "kinematic"}  # the reference is always there
    for measures in scores.values():
        assert set(measures["calibration"]) == {"50", "90"}
        assert list(measures["rmse"]) == list(measures["nll_at"]) == SECONDS
    assert picture.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "RMSE@5 s" in printed and "5.000" in printed and "6 forecasts in 6 scenes" in printed


def test_by_default_all_models_that_come_with_the_package_are_compared() -> None:
    assert list(load_models(COMPARED, "cpu", along_lanes=True)) == [*NAMES, *SHIPPED]


def test_on_streets_default_has_the_weights_that_runs_have_there(
    write: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    street, motorway = write(0.4, net="urban_like", name="street"), write(0.4)
    for recording, alike in ((street, True), (motorway, False)):
        scores = measure("--models", "default", "streets", "--recording", recording)
        assert (scores["default"]["rmse"] == scores["streets"]["rmse"]) == alike
    assert "different weights" in refusal(capsys, main, "--models", "default", "--recording", street, motorway)


# What cannot be used


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--models", "crystal_ball"], "crystal_ball"),
        (["--recording", "nowhere.parquet"], "nowhere.parquet: no such file"),
        (["--scenario", "nowhere"], "no such scenario"),
        (["--stride", "0"], "--stride 0: expected 1 or more"),
        (["--seed", "-1"], "--seed -1: expected 0 or more"),
        (["--batch", "-1"], "--batch -1"),
        (["--device", "abacus"], "--device abacus"),
    ],
)
def test_wrong_words_end_the_program(words: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    models = () if "--models" in words else ("--models", "kinematic")
    assert expected in refusal(capsys, main, *words, *models)


def test_a_graph_is_no_weights(write: Write, tmp_path: Path) -> None:
    graph = tmp_path / "mine.onnx"
    graph.touch()
    with pytest.raises(InputError, match=r"mine\.onnx: a graph, expected the file \*\.safetensors of the weights"):
        measure("--models", graph, "--recording", write(0.0))


def test_a_recording_of_less_than_eight_seconds_is_refused(write: Write) -> None:
    assert measure("--recording", write(0.0, last=80))["kinematic"]["scenes"] == 1
    with pytest.raises(InputError, match=r"made\.parquet: the recording is too short: 80 frames"):
        measure("--recording", write(0.0, last=79))


def test_a_part_without_vehicles_is_refused(write: Write) -> None:
    with pytest.raises(InputError, match="--split val: no vehicle"):
        measure("--recording", write(0.0), "--split", "val")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize("option", ["--json", "--plot"])
def test_results_that_cannot_be_written_are_an_error(
    option: str, write: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    status(main, "--models", *NAMES, "--recording", write(0.0), option, "/dev/full")
    printed = capsys.readouterr()
    assert printed.err.endswith("error: /dev/full: cannot be written: No space left on device\n")
    assert "RMSE@5 s" in printed.out, "what was measured is not lost"


@pytest.mark.data
def test_constant_velocity_on_real_traffic_is_about_as_published() -> None:
    """6.68 m at 5 s and 3.13 m at 3 s on all of NGSIM: the same protocol on 23 s of it is not far off."""
    if not os.environ.get("LITSIM_DATA"):
        pytest.skip("LITSIM_DATA names no folder with real recordings (ngsim/us101_0750_frames_0126_1149.parquet)")
    rmse = measure("--egos", "none")["constant_velocity"]["rmse"]
    assert rmse["5"] == pytest.approx(6.68, rel=0.25)
    assert rmse["3"] == pytest.approx(3.13, rel=0.25)
