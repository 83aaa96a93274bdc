"""Nothing is reported on what was trained on: read from the manifests of the weights themselves."""

import json
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
import yaml
from safetensors import safe_open

import litsim_policy
import litsim_research
import litsim_sim
from litsim_data.traffic.seeds import CALIBRATION, DEMO, PAPER, REPORTED, TRAINING
from litsim_predictor.inference import ON_STREETS, SHIPPED
from litsim_predictor.inference.weights import read_weights
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.scenario import packaged

POLICIES = sorted(
    weights
    for package in (litsim_policy, litsim_research)
    for weights in (Path(package.__file__).parent / "weights").glob("*.safetensors")
    if weights.stem != "speed_change"  # of recorded followers, by the split of encounters
)
REAL = yaml.safe_load((Path(litsim_sim.__file__).parent / "scenarios/us101_0750.yaml").read_text())


def trained_on(weights: Path) -> dict[str, Any]:
    """The `data` of the configuration that policy weights were trained with."""
    with safe_open(str(weights), framework="numpy") as file:
        return dict(json.loads(file.metadata()["config"])["data"])


def test_seeds_have_one_use() -> None:
    assert len(TRAINING | CALIBRATION | REPORTED) == len(TRAINING) + len(CALIBRATION) + len(REPORTED)
    assert len(REPORTED) == len(PAPER) + 3, "one each for freeways, the demo and the paper's left turn"
    assert POLICIES and SHIPPED


@pytest.mark.parametrize("weights", POLICIES, ids=lambda path: path.stem)
def test_policies_were_trained_on_segments_of_seeds_for_training_and_windows_beside_the_reported_one(
    weights: Path,
) -> None:
    data = trained_on(weights)
    seeds = {each["seed"] for each in data["generated"]}
    assert seeds <= TRAINING and not seeds & (CALIBRATION | REPORTED)
    assert "demo" not in data["scenarios"]
    first, last = REAL["crop"]["frame"]
    for window in data["real"]:
        begin, end = window["frames"]
        assert end < first or begin > last, f"{window} lies in the window of {REAL['name']}"


@pytest.mark.parametrize("name", SHIPPED)
def test_predictors_saw_nothing_that_is_reported(name: str) -> None:
    """Sources that could hold the reported window say which frames they have kept for tests; of generated traffic they
    saw the packaged recording of another seed than the demo's."""
    provenance = read_weights(name).provenance
    sources, rows = provenance.training["data"], provenance.manifest["rows"]
    kept = [source["test_frames"] for source in sources if source["kind"].startswith("us101")]
    assert kept and all(frames == REAL["crop"]["frame"] for frames in kept)
    assert rows["test"]["us101_windows"] > 0
    named = {each for part in rows.values() for each in part}
    assert not {source for source in named for seed in REPORTED | CALIBRATION if f"_{seed}_" in source}
    assert [file for source in sources if source["kind"] == "recording" for file in source["files"]] == [
        "us101_like.parquet"
    ]
    assert seed_of("us101_like.parquet") not in REPORTED | CALIBRATION
    demo = sha256(packaged("scenarios/demo.parquet").read_bytes()).hexdigest()
    assert demo not in provenance.manifest["files"].values()


def test_the_weights_for_streets_saw_nothing_that_is_reported() -> None:
    """Neither seeds of reported traffic nor a window of Lankershim that examples/suites/streets.yaml reports."""
    manifest = read_weights(ON_STREETS).provenance.manifest
    seeds = {int(name[-12:-8]) for name in manifest["files"] if name.startswith(("train_", "street_"))}
    assert len(seeds) == 17 and not seeds & (REPORTED | CALIBRATION)
    windows = {rows for part in manifest["rows"].values() for rows in part} - {"urban_like"}
    suite = (Path(__file__).parents[3] / "examples/suites/streets.yaml").read_text()
    assert windows == {"a", "c", "d"} and not [name for name in windows if f"/{name}_train" in suite]


def seed_of(file: str) -> int:
    """Seed of a packaged generated recording, as it says itself."""
    return int(load_recording(packaged(f"scenarios/{file}")).header.notes["seed"])


def test_the_demo_is_of_a_seed_for_reports_alone() -> None:
    assert seed_of("demo.parquet") == DEMO
    assert DEMO in REPORTED
