"""Segments: where recordings are cut, who can be the ego, and that a manifest reproduces all of it."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from command_line import refusal, status
from litsim_data import cli as data
from litsim_data import segments
from litsim_data.segments import Manifest, Settings, cut
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario, packaged

LANE_CENTRE = -5.49  # [m] of the second lane from the left of us101_like


def vehicle(
    number: int, first: int, last: int, speed: float = 12.0, kind: int = Kind.CAR, lane: int = 0
) -> pd.DataFrame:
    """A vehicle that drives along the straight net, and again from its start after 400 m."""
    frame = np.arange(first, last + 1)
    return pd.DataFrame(
        {
            "vehicle_id": number,
            "frame": frame,
            "x": 100.0 + speed * STEP_S * (frame - first),
            "y": LANE_CENTRE - 3.66 * lane,
            "yaw": 0.0,
            "speed": speed,
            "acceleration": 0.0,
            "length": 4.5,
            "width": 1.8,
            "kind": int(kind),
            "lane": 2 + lane,
        }
    )


def recording(*vehicles: pd.DataFrame) -> Recording:
    header = RecordingHeader(name="made", net="us101_like.net.xml")
    return Recording.from_table(header, pd.concat(vehicles), "made recording")


def long_recording(frames: int = 2810) -> Recording:
    """One vehicle every 7 s in one of three lanes, each there for 40 s."""
    starts = range(0, frames - 20, 70)
    return recording(
        vehicle(999, 0, frames - 1, speed=0.1, lane=3),
        *(vehicle(n, s, min(s + 400, frames - 1), 10.0, lane=n % 3) for n, s in enumerate(starts, start=1)),
    )


def cut_one(made: Recording, **settings: object) -> Manifest:
    return cut([("made.parquet", "us101_like", None, made)], Settings.model_validate(settings))


def test_segments_keep_to_their_part_of_the_split() -> None:
    manifest = cut_one(long_recording())
    assert manifest.recordings[0].frames == (0, 2809)
    frames = {part: [s.frames for s in manifest.segments if s.part == part] for part in segments.PARTS}
    assert [first for first, _ in frames["train"]] == [281 * n for n in range(7)]
    assert frames["val"] == [(1967, 2247)]
    assert [first for first, _ in frames["test"]] == [2248, 2529]
    assert all(last - first == 280 for part in frames.values() for first, last in part)
    assert not any(segment.shortened for segment in manifest.segments)


def test_short_parts_are_shortened_segments_and_shorter_ones_none() -> None:
    manifest = cut_one(long_recording(600))  # parts of 42, 6 and 12 s
    assert [(s.part, s.frames, s.shortened) for s in manifest.segments] == [("train", (0, 280), False)]
    manifest = cut_one(long_recording(600), ego_min_s=4.0)
    assert [(s.part, s.frames, s.shortened) for s in manifest.segments][1:] == [("test", (480, 599), True)]
    with pytest.raises(InputError, match="no segment found"):
        cut_one(long_recording(100))


def test_egos_are_there_and_move() -> None:
    made = recording(
        vehicle(1, 0, 280, 8.0, lane=1),
        vehicle(2, 0, 129, 8.0, lane=2),  # leaves a step too early
        vehicle(3, 0, 130, 8.0, lane=3),
        vehicle(4, 1, 280, 8.0, lane=4),  # comes a step too late
        vehicle(5, 0, 280, 0.5, lane=0),  # stands
        vehicle(6, 0, 280, 8.0, Kind.MOTORCYCLE, lane=0).assign(x=lambda t: t["x"] + 100),
    )
    (segment,) = cut_one(made, split=(1.0, 0.0, 0.0)).segments
    assert sorted(segment.egos) == [1, 3]
    assert segment.egos[0] == segment.ego
    assert not segment.shortened


def test_pieces_without_an_ego_are_left_out_and_counted() -> None:
    manifest = cut_one(recording(vehicle(1, 0, 280, 1.2), vehicle(2, 281, 561, 0.0)), split=(1.0, 0.0, 0.0))
    assert len(manifest.segments) == 1 and manifest.without_ego == 1


def test_seeds_choose_other_egos_of_the_same_pieces() -> None:
    first, again, other = (cut_one(long_recording(), seed=seed) for seed in (1, 1, 2))
    assert first == again
    assert [s.frames for s in first.segments] == [s.frames for s in other.segments]
    assert [s.ego for s in first.segments] != [s.ego for s in other.segments]


def test_vehicles_are_split_by_id() -> None:
    made = recording(
        *(vehicle(10 * n, 0, 200, 9.0, lane=n % 5).assign(x=lambda t, n=n: t.x + 9 * n) for n in range(1, 11))
    )
    for split in ((0.7, 0.1, 0.2), (1.0, 0.0, 0.0)):  # that by time, which is another
        source = cut_one(made, split=split, ego_min_s=5.0).recordings[0]
        assert source.vehicles == (70, 80)


def test_pedestrians_are_no_vehicles_of_the_split() -> None:
    walkers = [vehicle(100 + n, 0, 200, 1.0).assign(kind=int(Kind.PEDESTRIAN), y=5.0 + n) for n in range(5)]
    made = recording(*(vehicle(n, 0, 200, 9.0).assign(x=lambda t, n=n: t.x + 9 * n) for n in range(1, 11)), *walkers)
    assert cut_one(made, ego_min_s=5.0).recordings[0].vehicles == (7, 8)


def test_parts_of_the_split_follow_each_other_by_id() -> None:
    for count in (10, 100, 1000):
        part = segments.parts_of(np.repeat(np.arange(count), 3))
        assert [int((part == k).sum()) for k in range(3)] == [2.1 * count, 0.3 * count, 0.6 * count]
    assert (np.diff(part) >= 0).all()
    few = [[segments.PARTS[k] for k in segments.parts_of(np.arange(count))] for count in (0, 1, 2)]
    assert few == [[], ["test"], ["train", "test"]]


def test_splits_that_are_none() -> None:
    with pytest.raises(InputError, match="three shares that add up to 1"):
        cut_one(long_recording(), split=(0.7, 0.2, 0.2))


def test_the_digest_is_of_the_content(tmp_path: Path) -> None:
    made = long_recording(300)
    made.write(tmp_path / "made.parquet")
    assert segments.content_digest(Recording.read(tmp_path / "made.parquet")) == segments.content_digest(made)
    table = made.table.copy()
    table.loc[5, "x"] += 1e-9
    assert segments.content_digest(Recording.of_table(made.header, table)) != segments.content_digest(made)


def test_the_command_writes_scenarios_that_load_and_a_manifest_that_reproduces_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out, again = tmp_path / "data" / "made.parquet", tmp_path / "cut", tmp_path / "elsewhere" / "again"
    long_recording(600).write(file)
    data.main(["segments", str(file), "--out", str(out), "--ego-min", "4", "--seed", "5"])
    assert "2 segments of 1 recordings" in capsys.readouterr().out
    names = sorted(path.name for path in out.iterdir())
    assert names == ["made_test_00.yaml", "made_train_00.yaml", "manifest.yaml"]
    scenario = Scenario.load(out / "made_test_00.yaml")
    assert (scenario.start_frame, scenario.total_steps, scenario.history_steps) == (480, 119, 30)
    assert not scenario.shortened
    assert str(tmp_path) not in (out / "manifest.yaml").read_text() + (out / "made_test_00.yaml").read_text()

    data.main(["segments", "--manifest", str(out / "manifest.yaml"), "--out", str(again)])
    assert [path.name for path in sorted(again.iterdir())] == names
    assert Manifest.read(again / "manifest.yaml").segments == Manifest.read(out / "manifest.yaml").segments
    Scenario.load(again / "made_train_00.yaml")
    data.main(["segments", "--manifest", str(again / "manifest.yaml"), "--out", str(out)])
    assert Manifest.read(out / "manifest.yaml").recordings[0].file == "../data/made.parquet"


def test_scenarios_that_cannot_be_loaded_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = long_recording(1200)
    table = made.table.copy()
    table.loc[(table["frame"] >= 600) & (table["vehicle_id"] % 4 == 1), "y"] += 60.0  # a quarter of the later rows
    Recording.of_table(made.header, table).write(tmp_path / "made.parquet")
    command = ["segments", str(tmp_path / "made.parquet"), "--out", str(tmp_path / "cut"), "--split", "1", "0", "0"]
    data.main(command)
    said = capsys.readouterr().out
    assert "2 of 4 scenarios can be loaded" in said and "2 cannot for their coverage" in said
    assert "made_train_03.yaml: net us101_like.net.xml does not cover the recording" in said
    with pytest.raises(InputError, match=r"expected 90% \(field coverage_min\)"):
        Scenario.load(tmp_path / "cut" / "made_train_03.yaml")
    data.main([*command, "--coverage-min", "0.5"])
    assert "4 of 4 scenarios can be loaded" in capsys.readouterr().out
    assert 0.5 < Scenario.load(tmp_path / "cut" / "made_train_03.yaml").coverage < 0.9
    data.main(["segments", "--manifest", str(tmp_path / "cut" / "manifest.yaml"), "--out", str(tmp_path / "b")])
    assert "4 of 4" in capsys.readouterr().out
    table["y"] += 60.0
    Recording.of_table(made.header, table).write(tmp_path / "made.parquet")
    assert status(data.main, *command) == 1
    assert "0 of 4 scenarios can be loaded" in capsys.readouterr().out


def test_manifests_refuse_other_recordings_and_edits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "made.parquet", tmp_path / "cut"
    long_recording(600).write(file)
    data.main(["segments", str(file), "--out", str(out)])
    again = ["segments", "--manifest", str(out / "manifest.yaml"), "--out", str(tmp_path / "again")]

    def refused(message: str) -> None:
        assert message in refusal(capsys, data.main, *again)

    text = (out / "manifest.yaml").read_text()
    fields = yaml.safe_load(text)
    fields["segments"][0]["ego"] += 1
    (out / "manifest.yaml").write_text(yaml.safe_dump(fields))
    refused("was it edited?")
    (out / "manifest.yaml").write_text("litsim_segments: 2")
    refused("field litsim_segments")
    (out / "manifest.yaml").write_text(text)
    long_recording(610).write(file)
    refused("the digest of its content differs")
    file.unlink()
    refused("no such recording")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "either recordings or --manifest"),
        (["absent.parquet"], "no such recording"),
        (["my run (1).parquet"], "my run (1).parquet: scenarios are named after the file: expected up to 100 letters"),
        ([str(packaged("scenarios/us101_like.parquet")), "--net", "absent.net.xml"], "expected a file there"),
        ([str(packaged("scenarios/us101_like.parquet")), "--stride", "0"], "stride_s is 0.0"),
        ([str(packaged("scenarios/us101_like.parquet")), "--simulation", "inf"], "simulation_s is inf"),
        ([str(packaged("scenarios/us101_like.parquet")), "--history", "0.01"], "history_s is 0.01"),
        ([str(packaged("scenarios/us101_like.parquet")), "--seed", str(2**64)], "seed is 18446744073709551616"),
        ([str(packaged("scenarios/us101_like.parquet")), "--split", "nan", "0", "1"], "the split is (nan, 0.0, 1.0)"),
        ([str(packaged("scenarios/us101_like.parquet")), "--ego-min", "30"], "expected at most simulation_s"),
        ([str(packaged("scenarios/us101_like.parquet")), "--crop", "frame", "1", "x"], "expected a column and two"),
    ],
)
def test_errors_of_the_command(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in refusal(capsys, data.main, "segments", *arguments, "--out", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_real_data_is_named_by_its_variable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LITSIM_DATA", str(tmp_path / "data"))
    long_recording(600).write(tmp_path / "data" / "site" / "made.parquet")
    data.main(["segments", str(tmp_path / "data" / "site" / "made.parquet"), "--out", str(tmp_path / "cut")])
    manifest = Manifest.read(tmp_path / "cut" / "manifest.yaml")
    assert manifest.recordings[0].file == "${LITSIM_DATA}/site/made.parquet"
    assert Scenario.load(tmp_path / "cut" / "made_train_00.yaml").total_steps == 280
    data.main(["segments", "--manifest", str(tmp_path / "cut" / "manifest.yaml"), "--out", str(tmp_path / "b" / "c")])
