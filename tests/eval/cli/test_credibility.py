"""`credibility`: measures, page and evidence of encounters in files, and what is wrong in one line."""

import csv
import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from command_line import status
from litsim_eval.cli import credibility
from made_encounters import encounter_note
from planted_drivers import encounter_files

ASKED = (
    *("position_error_m", "onset_error_s", "least_gap_m", "least_gap_people_m", "ttc_below_2", "ttc_below_2_people"),
    *("strongest_braking_mps2", "strongest_braking_people_mps2", "contacts", "near_misses", "near_misses_people"),
    "near_miss_auc",
)


called = partial(status, credibility.main)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encounter_files(tmp_path_factory.mktemp("encounters"), encounter_note(), ("one", "two"))


def test_measures_table_page_and_rows_are_written(folder: Path, tmp_path: Path, capsys) -> None:
    out, words = tmp_path / "out", ("--policy", "idm", "replay", "--json", tmp_path / "own.json")
    assert called("--recording", folder, "--out", out, *words) == 0
    values = json.loads((out / "credibility.json").read_text())
    assert values == json.loads((tmp_path / "own.json").read_text())
    assert values["encounters"] == 2 and list(values["policies"]) == ["idm", "replay"]
    assert all(name in own for own in values["policies"].values() for name in ASKED)
    assert values["policies"]["replay"]["contacts"] == 2 > values["policies"]["idm"]["contacts"]
    rows = list(csv.DictReader((out / "credibility.csv").open()))
    assert [row["driven_by"] for row in rows] == ["people"] * 2 + ["idm"] * 2 + ["replay"] * 2
    page = (out / "credibility.html").read_text()
    assert "src=" not in page and page.count("<figure>") == 8
    assert capsys.readouterr().out.splitlines()[-1] == f"page: {out / 'credibility.html'}"


def test_drawn_drivers_are_scored(folder: Path, tmp_path: Path) -> None:
    words = ("--policy", "idm", "--limit", 1, "--drivers", 2, "--json", tmp_path / "own.json")
    assert called("--recording", folder, *words) == 0
    own = json.loads((tmp_path / "own.json").read_text())["policies"]["idm"]
    assert own["crps_4s_m"] > 0.0 and own["coverage_50"] is not None


def test_a_changed_byte_of_the_evidence_is_found(folder: Path, tmp_path: Path, capsys) -> None:
    pack = tmp_path / "pack"
    assert called("--recording", folder / "one.yaml", "--policy", "idm", "--evidence", pack) == 0
    assert called("--check", pack) == 0
    text = (pack / "credibility.csv").read_bytes()
    (pack / "credibility.csv").write_bytes(text[:-2] + b"9\n")
    (pack / "bars.yaml").unlink()
    (pack / "more").touch()
    assert called("--check", pack) == 1
    said = capsys.readouterr().err
    assert all(words in said for words in ("credibility.csv: has changed", "bars.yaml: is missing", "more: is not of"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--policy", "idn"], "--policy idn (near: idm)"),
        (["--set", "conflict.horizon=-1"], "parameter horizon is -1"),
        (["--split", "reported"], "no encounter of part reported"),
        (["--recording", "nowhere"], "nowhere"),
        (["--check", "nowhere"], "nowhere/SHA256SUMS: no such file"),
    ],
)
def test_what_is_wrong_is_said_before_the_first_run(folder: Path, words: list[str], said: str, capsys) -> None:
    given = words if words[0] == "--recording" else ["--recording", folder, *words]
    assert called(*given) == 2
    assert said in capsys.readouterr().err


def test_a_folder_without_encounters_is_refused(tmp_path: Path, capsys) -> None:
    assert called("--recording", tmp_path) == 2
    assert "no scenario in this folder" in capsys.readouterr().err


def test_without_data_the_packaged_encounters_are_refused(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.delenv("LITSIM_DATA", raising=False)
    assert called("--policy", "idm") == 2
    assert "LITSIM_DATA is not set, expected the folder with NGSIM's files" in capsys.readouterr().err


def test_packaged_encounters_are_built_from_the_data(real_data, tmp_path: Path) -> None:
    real_data("ngsim/i80_car_following_pairs.parquet")
    real_data("ngsim/us101_vehicle_tracks.parquet")
    assert called("--policy", "critic", "--limit", 2, "--evidence", tmp_path) == 0
    values = json.loads((tmp_path / "credibility.json").read_text())
    assert list(values["policies"]) == ["critic"] and values["splits"] == {"reported": 2}
    assert "| ngsim/i80_car_following_pairs.parquet | CC BY-SA | 1 |" in (tmp_path / "evidence.md").read_text()


def test_encounters_are_found_in_a_scenario(tmp_path: Path) -> None:
    assert called("--recording", "demo", "--policy", "replay", "--limit", 2, "--json", tmp_path / "own.json") == 0
    values = json.loads((tmp_path / "own.json").read_text())
    assert values["encounters"] == 2 and values["policies"]["replay"]["taken_over"] == 0.0


def test_a_recording_in_which_nobody_has_to_react_is_refused(make_scenario, track, tmp_path: Path, capsys) -> None:
    path = tmp_path / "free.yaml"
    path.write_text(make_scenario(track(1, x=200.0), track(2, x=60.0)).to_yaml())
    assert called("--recording", path, "--policy", "idm") == 2
    assert f"{path}: no moment in which a vehicle had to react" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"onset_step": None}, "field onset_step: Input should be a valid integer"),
        ({"onset_step": 7}, "onset_step is 7, expected the history, 40"),
        ({"truth": {}}, "field truth.agent: Field required"),
    ],
)
def test_a_malformed_encounter_is_refused_in_one_line(
    change: dict[str, Any], said: str, tmp_path: Path, capsys
) -> None:
    folder = encounter_files(tmp_path, encounter_note() | change)
    assert called("--recording", folder) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
