"""`data encounters`: what it writes, and what it refuses in one line."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

from command_line import status
from litsim_data import cli as data
from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.following import LANES, PAIRS, VEHICLES
from litsim_data.encounters.packaged import WINDOWS, rows
from litsim_data.encounters.table import table_rows
from litsim_sim.core.errors import EXIT_INPUT
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario
from made_traffic import braking, straight

called = partial(status, data.main, "encounters")


def test_the_demo_gives_scenarios_with_their_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert called("demo", tmp_path / "out", "--kinds", "cut_in", "--split", "reported") == 0
    table = table_rows((tmp_path / "out" / "encounters.csv").read_text())
    assert capsys.readouterr().out.splitlines()[-1] == f"{len(table)} encounters: {len(table)} cut_in"
    encounter = Encounter.of_scenario(Scenario.load(tmp_path / "out" / f"{table[0].name}.yaml"))
    assert (encounter.note.kind, encounter.note.split) == ("cut_in", "reported")
    assert (encounter.note.agent, encounter.note.opponent) == (table[0].agent, table[0].opponent)
    assert encounter.people.least_gap == pytest.approx(table[0].least_gap_m, abs=0.01)


def test_equal_inputs_give_equal_files(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    assert called("demo", first, "--kinds", "cut_in") == called("demo", second, "--kinds", "cut_in") == 0
    assert {path.name: path.read_bytes() for path in first.iterdir()} == {
        path.name: path.read_bytes() for path in second.iterdir()
    }


def made(path: Path, **changes: object) -> Path:
    """A recording of a leader that brakes, in which columns differ."""
    leader = braking(2, 60.0, 1, [(0, 14), (5, 14), (7, 9), (12, 9)])
    follower = braking(1, 35.0, 1, [(0, 14), (6, 14), (8, 9), (12, 9)])
    table = pd.concat([leader.rows(), follower.rows()], ignore_index=True).assign(**changes)
    Recording.of_table(RecordingHeader("made"), table.sort_values(["frame", "vehicle_id"])).write(path)
    return path


def test_a_recording_needs_a_net(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = made(tmp_path / "made.parquet")
    assert called(recording, tmp_path / "out") == EXIT_INPUT
    assert "no net named in its header" in capsys.readouterr().err
    assert called(recording, tmp_path / "out", "--net", "us101_like") == 0
    assert capsys.readouterr().out.splitlines()[-1] == "1 encounters: 1 leader_brakes"


def test_a_recording_without_encounters_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = straight(1, 20.0, 10.0, 1).rows()
    Recording.from_table(RecordingHeader("made"), table, "made").write(tmp_path / "made.parquet")
    assert called(tmp_path / "made.parquet", tmp_path / "out", "--net", "us101_like") == EXIT_INPUT
    assert "made.parquet: no encounter of the kinds asked for" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_holes_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = Recording.read(made(tmp_path / "made.parquet"))
    recording.take(recording.columns["frame"] != 50).write(tmp_path / "holes.parquet")
    assert called(tmp_path / "holes.parquet", tmp_path / "out", "--net", "us101_like") == EXIT_INPUT
    assert "frame 49 is followed by a hole" in capsys.readouterr().err


def test_nothing_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").touch()
    assert called("demo", tmp_path) == EXIT_INPUT
    assert f"{tmp_path}: exists already, expected a new folder" in capsys.readouterr().err


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert called() == EXIT_INPUT
    assert "name a RECORDING and the folder OUT" in capsys.readouterr().err
    monkeypatch.delenv("LITSIM_DATA", raising=False)
    assert called("packaged", "out") == EXIT_INPUT
    assert "LITSIM_DATA is not set" in capsys.readouterr().err


@pytest.mark.data
def test_packaged_encounters_are_written_as_scenarios(tmp_path: Path, real_data: Callable[..., Path]) -> None:
    for name in (PAIRS, LANES, VEHICLES, WINDOWS):
        real_data(name)
    assert called("packaged", tmp_path / "out", "--kinds", "standing", "cut_in", "--split", "reported") == 0
    wanted = [row for row in rows("reported") if row.kind in ("standing", "cut_in")]
    assert {path.stem for path in (tmp_path / "out").glob("*.yaml")} == {row.name for row in wanted}
    scenario = Scenario.load(tmp_path / "out" / f"{wanted[0].name}.yaml")
    assert Encounter.of_scenario(scenario).note.opponent == wanted[0].opponent
