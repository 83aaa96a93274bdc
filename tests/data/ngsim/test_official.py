"""Official NGSIM files: both formats, every defect with its line."""

import errno
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from litsim_data.generic.mapping import FOOT
from litsim_data.generic.resampling import PIECE
from litsim_data.ngsim import official as ngsim
from litsim_data.ngsim import reading
from litsim_data.ngsim.sites import I80, LANKERSHIM, PEACHTREE, SITES, US101, site_at, site_of
from litsim_data.ngsim.summary import summary
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording
from made_ngsim import Traffic, global_from_map, table, write_portal, write_text

LANE = 3.66  # [m]


def made(site: Any = US101, period: str = "0750", rows: int = 2000, **fields: Any) -> pd.DataFrame:
    return table(Traffic(site, period, rows, **({"noise": 0.0} | fields)))


@pytest.fixture
def text(tmp_path: Path) -> Path:
    """A small motorway file."""
    path = tmp_path / "trajectories-0750am-0805am.txt"
    write_text(made(), path)
    return path


def raw(path: Path, out: Path, **options: Any) -> Recording:
    """The one recording that comes out of a conversion without cleaning."""
    (one,) = ngsim.convert(path, out, **({"cleaned": False} | options))
    return Recording.read(one.path)


def edited(path: Path, change: Callable[[list[str]], object]) -> Path:
    """`path` with `change` done to the list of its lines."""
    lines = path.read_text().splitlines()
    change(lines)
    path.write_text("\n".join(lines) + "\n")
    return path


def put(line: int, column: int, value: str) -> Callable[[list[str]], None]:
    """A change of one cell of a text file; lines from 1, columns from 0."""

    def change(lines: list[str]) -> None:
        cells = lines[line - 1].split()
        cells[column] = value
        lines[line - 1] = " ".join(cells)

    return change


# Sites


@pytest.mark.parametrize("site", SITES.values(), ids=list(SITES))
def test_map_frames_are_rigid_and_invertible(site: Any) -> None:
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-300, 300, 20), rng.uniform(-300, 300, 20)
    global_x, global_y = global_from_map(site, x, y)
    np.testing.assert_allclose(site.map_from_global(global_x, global_y), (x, y), atol=1e-6)
    np.testing.assert_allclose(np.hypot(np.diff(x), np.diff(y)), np.hypot(np.diff(global_x), np.diff(global_y)))
    assert site.holds(global_x, global_y).all()
    assert site_at(site.location.upper()) is site


def test_published_rows_are_where_the_road_runs() -> None:
    """Two published rows of I-80: x is about Local_Y and y about minus Local_X, in feet."""
    x, y = I80.map_from_global(np.array([6042814.264, 6042863.582]) * FOOT, np.array([2133542.012, 2133247.751]) * FOOT)
    np.testing.assert_allclose(x / FOOT, [472.9, 174.7], atol=3.0)
    np.testing.assert_allclose(y / FOOT, [-41.4, -54.3], atol=3.0)


def test_neighbouring_sites_are_told_apart_by_the_day() -> None:
    x, y = US101.global_anchor
    morning = {US101: 1118847000000, LANKERSHIM: 1118935800000}
    for site, time_ms in morning.items():
        assert site_of(time_ms, x, y, urban=False) is site
    assert site_of(0, x, y, urban=True) is LANKERSHIM
    assert site_of(0, x + 1e5, y, urban=True) is None
    assert US101.period(morning[US101]) == "0750"
    assert PEACHTREE.period(1163019600000 + 3 * 3_600_000 + 60_000 * 33) == "1933"  # no published one


# Both formats


def test_text_becomes_box_centres_in_si_units(text: Path, tmp_path: Path) -> None:
    recording = raw(text, tmp_path / "out.parquet")
    assert recording.header.name == "us101_0750"
    assert recording.header.net == "us101.net.xml"
    assert recording.header.licence == "CC BY-SA"
    rows = recording.table
    source = made()
    assert len(rows) == len(source)
    merged = rows.merge(source, on=["vehicle_id", "frame"], suffixes=("", "_ft"))
    front = merged["x"] + 0.5 * merged["length"] * np.cos(merged["yaw"])
    np.testing.assert_allclose(front, merged["local_y"] * FOOT, atol=2e-3)
    np.testing.assert_allclose(merged["y"], -LANE * (merged["lane"] - 0.5), atol=2e-3)
    np.testing.assert_allclose(merged["yaw"], 0.0, atol=1e-3)
    np.testing.assert_allclose(merged["speed"], merged["speed_ft"] * FOOT, atol=1e-9)
    np.testing.assert_allclose(merged["length"], merged["length_ft"] * FOOT)
    assert set(rows["kind"]) == {Kind.CAR, Kind.TRUCK}


@pytest.mark.parametrize("commas", [True, False])
def test_portal_says_the_same_as_text(text: Path, tmp_path: Path, commas: bool) -> None:
    portal = tmp_path / "portal.csv"
    write_portal(made().sample(frac=1.0, random_state=0), portal, commas=commas)
    pd.testing.assert_frame_equal(
        raw(portal, tmp_path / "a.parquet").table, raw(text, tmp_path / "b.parquet").table, atol=1e-9, rtol=0.0
    )


def test_headers_in_other_spelling_and_order(text: Path, tmp_path: Path) -> None:
    portal = tmp_path / "portal.csv"
    write_portal(made(), portal, commas=False)
    given = pd.read_csv(portal).rename(columns={"Space_Headway": "Space_Hdwy", "Time_Headway": "time hdwy"})
    given = given[reversed(given.columns)].rename(columns=str.upper)
    other = tmp_path / "other.csv"
    given.to_csv(other, index=False, sep=";", lineterminator="\r\n", encoding="utf-8-sig")
    pd.testing.assert_frame_equal(
        raw(other, tmp_path / "a.parquet").table, raw(text, tmp_path / "b.parquet").table, atol=1e-9, rtol=0.0
    )


def test_streets_keep_both_directions(tmp_path: Path) -> None:
    path = tmp_path / "lankershim.txt"
    write_text(made(LANKERSHIM, "0830"), path)
    recording = raw(path, tmp_path / "out.parquet")
    assert recording.header.name == "lankershim_0830"
    yaw = recording.table["yaw"].to_numpy()
    assert (np.abs(yaw) < 0.01).any() and (np.abs(np.abs(yaw) - np.pi) < 0.01).any()
    assert ((np.abs(yaw) < 0.01) | (np.abs(np.abs(yaw) - np.pi) < 0.01)).all()


def test_a_folder_gets_a_file_for_every_site_and_period(tmp_path: Path) -> None:
    portal = tmp_path / "portal.csv"
    parts = [made(US101, "0750"), made(US101, "0805", seed=1), made(I80, "1700"), made(PEACHTREE, "1600")]
    write_portal(pd.concat(parts).sample(frac=1.0, random_state=1), portal)
    converted = ngsim.convert(portal, tmp_path / "out.parquet", cleaned=False)
    assert [one.name for one in converted] == ["us101_0750", "us101_0805", "i80_1700", "peachtree_1600"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "i80_1700.parquet", "peachtree_1600.parquet", "us101_0750.parquet", "us101_0805.parquet"
    ]  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "portal.csv"]
    for one, part in zip(converted, parts, strict=True):  # ids are given anew in every period: none are merged
        assert one.vehicles == part["vehicle_id"].nunique()
        assert one.counts.rows == len(part)


def test_one_clock_through_two_periods(tmp_path: Path) -> None:
    late = made(I80, "1700")
    late = late.assign(frame=late["frame"] + 36000)
    late["time_ms"] = made(I80, "1600")["time_ms"].min() + 100 * (late["frame"] - made(I80, "1600")["frame"].min())
    portal = tmp_path / "portal.csv"
    write_portal(pd.concat([made(I80, "1600"), late]), portal)
    assert [one.name for one in ngsim.convert(portal, tmp_path / "out", cleaned=False)] == ["i80_1600", "i80_1700"]


def test_cleaned_positions_stay_close_and_motion_is_smooth(tmp_path: Path) -> None:
    path = tmp_path / "noisy.txt"
    write_text(made(noise=0.05), path)
    (one,) = ngsim.convert(path, tmp_path / "out.parquet")
    assert Recording.read(one.path).header.notes["cleaned"] is True
    cleaned = Recording.read(one.path).table
    assert (cleaned["acceleration"].abs() < 3.0).mean() > 0.99
    merged = cleaned.merge(made(), on=["vehicle_id", "frame"], suffixes=("", "_ft"))
    front = merged["x"] + 0.5 * merged["length"] * np.cos(merged["yaw"])
    assert (front - merged["local_y"] * FOOT).abs().median() < 0.1


# What is mended


def test_duplicates_are_dropped_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "twice.txt"
    rows = made()
    write_text(pd.concat([rows, rows.iloc[10:30]]), path)
    (one,) = ngsim.convert(path, tmp_path / "out.parquet", cleaned=False)
    assert one.counts.left_out == {"exact copy of another": 20}
    assert one.counts.rows == len(rows)


def test_short_holes_are_filled_long_ones_split(tmp_path: Path) -> None:
    rows = made()
    first = rows[rows["vehicle_id"] == 1]["frame"].min()
    missing = [*range(first + 40, first + 43), *range(first + 100, first + 130)]
    path = tmp_path / "holes.txt"
    write_text(rows[~((rows["vehicle_id"] == 1) & rows["frame"].isin(missing))], path)
    (one,) = ngsim.convert(path, tmp_path / "out.parquet", cleaned=False)
    assert (one.counts.rows, one.counts.pieces) == (len(rows) - 30, one.counts.tracks + 1)
    tracks = Recording.read(one.path).table
    assert {1, 1 + PIECE} <= set(tracks["vehicle_id"])
    begun = tracks[tracks["vehicle_id"] == 1].sort_values("frame")
    assert begun["frame"].max() == first + 99
    np.testing.assert_allclose(np.diff(begun["x"], 2), 0.0, atol=0.05)  # interpolated without a step


def test_one_refused_recording_does_not_keep_the_others(tmp_path: Path) -> None:
    bad = made(I80, "1600")
    bad.loc[100:160, "global_x"] += 30.0
    portal = tmp_path / "portal.csv"
    write_portal(pd.concat([bad, made(I80, "1600"), made(US101, "0750")]), portal)
    with pytest.raises(InputError, match=r"^i80_1600: .*is at two places.*; made are us101_0750$"):
        ngsim.convert(portal, tmp_path / "out", cleaned=False)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["us101_0750.parquet"]


def test_an_id_that_jumps_is_two_vehicles(tmp_path: Path) -> None:
    rows = made()
    mine = rows["vehicle_id"] == 2
    middle = rows[mine]["frame"].median()
    jump = mine & (rows["frame"] > middle)
    rows.loc[jump, "global_x"] += 60.0
    rows.loc[jump, "global_y"] -= 60.0
    path = tmp_path / "jump.txt"
    write_text(rows, path)
    (one,) = ngsim.convert(path, tmp_path / "out.parquet", cleaned=False)
    assert one.counts.jumps == 1
    assert 2 + PIECE in set(Recording.read(one.path).table["vehicle_id"])


def test_contradicting_rows_are_left_out_or_refused(tmp_path: Path) -> None:
    rows = made()
    wrong = rows.iloc[[100]].assign(global_x=lambda r: r["global_x"] + 30.0)
    path = tmp_path / "two places.txt"
    write_text(pd.concat([rows, wrong]), path)
    (one,) = ngsim.convert(path, tmp_path / "out.parquet", cleaned=False)
    assert one.counts.left_out == {"the vehicle is elsewhere at the same time": 2}
    assert one.counts.rows == len(rows), "interpolated"
    many = rows.iloc[100:160].assign(global_x=lambda r: r["global_x"] + 30.0)
    write_text(pd.concat([rows, many]), path)
    with pytest.raises(InputError, match=r"two places.txt: lines 101 and 2001: Vehicle_ID \d+ is at two places"):
        ngsim.convert(path, tmp_path / "out.parquet", cleaned=False)


def test_a_vehicle_without_size_gets_the_usual_one(text: Path, tmp_path: Path) -> None:
    rows = made()
    rows.loc[rows["vehicle_id"] == 1, "width"] = 0.0
    write_text(rows, text)
    (one,) = ngsim.convert(text, tmp_path / "out.parquet", cleaned=False)
    table = Recording.read(one.path).table
    assert table.loc[table["vehicle_id"] == 1, "width"].unique().tolist() == [2.0]


# What is refused, with the line


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put(7, 11, "fast"), r"line 7: column v_Vel is 'fast', no number"),
        (put(7, 0, "1.5"), r"line 7: column Vehicle_ID is 1.5, no whole number"),
        (put(7, 6, "nan"), r"line 7: column Global_X is empty or not finite"),
        (put(9, 17, "1 2"), r"line 9: 19 columns, expected 18: "),
        (lambda lines: lines.__setitem__(4, "1 2 3"), r"line 5: 3 columns, expected 18: '1 2 3'"),
    ],
)
def test_lines_that_cannot_be_read(text: Path, tmp_path: Path, change: Any, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(text.name) + ": " + message):
        ngsim.convert(edited(text, change), tmp_path / "out.parquet", cleaned=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == [text.name]


def test_the_line_is_right_in_later_blocks_and_after_empty_lines(
    text: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "BLOCK", 4096)
    edited(text, put(1500, 11, "fast"))
    with pytest.raises(InputError, match="line 1500: column v_Vel"):
        ngsim.convert(text, tmp_path / "out.parquet")
    edited(text, lambda lines: lines.insert(1480, ""))
    with pytest.raises(InputError, match="line 1501: column v_Vel"):
        ngsim.convert(text, tmp_path / "out.parquet")
    edited(text, lambda lines: lines.insert(100, ""))
    with pytest.raises(InputError, match="line 1502: column v_Vel"):
        ngsim.convert(text, tmp_path / "out.parquet")


def test_a_quotation_mark_swallows_no_lines(tmp_path: Path) -> None:
    portal = tmp_path / "portal.csv"
    write_portal(made(), portal, commas=False)
    for line in (6, 8):
        edited(portal, lambda lines, at=line - 1: lines.__setitem__(at, lines[at].replace(",", ',"', 1)))
    with pytest.raises(InputError, match=r"line 6: a quotation mark that is not closed in this line|line 6: "):
        ngsim.convert(portal, tmp_path / "out")


def test_metres_are_refused(text: Path, tmp_path: Path) -> None:
    rows = made()
    sizes = rows.assign(length=rows["length"] * FOOT, width=rows["width"] * FOOT)
    write_text(sizes, text)
    with pytest.raises(InputError, match=r"line 1 and after: column v_Length has median 4\.\d+, .* looks like metres"):
        ngsim.convert(text, tmp_path / "out.parquet")
    places = rows.assign(global_x=rows["global_x"] * FOOT, global_y=rows["global_y"] * FOOT)
    write_text(places, text)
    with pytest.raises(InputError, match=r"line 1: Global_X, Global_Y are .* these are metres"):
        ngsim.convert(text, tmp_path / "out.parquet")


def test_a_file_that_is_cut_off(text: Path, tmp_path: Path) -> None:
    whole = text.read_text()
    text.write_text(whole.rstrip())  # only the last end of line is missing: nothing is lost
    rows = len(raw(text, tmp_path / "whole.parquet").table)
    last = whole.rstrip().rpartition("\n")[2]
    assert rows == 2000
    text.write_text(whole.rstrip()[: -len(last) // 2])
    with pytest.raises(InputError, match=r"line 2000: \d+ columns, expected 18: .*; the file ends within this line"):
        ngsim.convert(text, tmp_path / "out.parquet")


def test_frames_at_another_rate(text: Path, tmp_path: Path) -> None:
    rows = made(rows=8000)
    write_text(rows.assign(time_ms=rows["time_ms"].min() + 3000 * (rows["frame"] - rows["frame"].min())), text)
    with pytest.raises(InputError, match=r"line \d+: Frame_ID \d+ at Global_Time \d+: .* do not run together at 10 Hz"):
        ngsim.convert(text, tmp_path / "out.parquet")


def test_an_unknown_place(tmp_path: Path) -> None:
    portal = tmp_path / "portal.csv"
    rows = made()
    rows.loc[3, "location"] = "us-66"
    write_portal(rows, portal)
    with pytest.raises(InputError, match="line 5: column Location is 'us-66', expected one of us-101, i-80, "):
        ngsim.convert(portal, tmp_path / "out")


def test_a_few_rows_off_the_site_are_left_out(text: Path, tmp_path: Path) -> None:
    (one,) = ngsim.convert(edited(text, put(50, 6, "0")), tmp_path / "out.parquet", cleaned=False)
    assert (one.counts.rows, one.counts.left_out) == (len(made()), {"off the site": 1})
    for line in range(100, 140):
        edited(text, put(line, 6, "0"))
    with pytest.raises(InputError, match=r"line 50: Global_X, Global_Y are 0\.0, .* at no NGSIM site"):
        ngsim.convert(text, tmp_path / "out.parquet")


def test_headers_with_defects(tmp_path: Path) -> None:
    portal = tmp_path / "portal.csv"
    write_portal(made(), portal)
    content = portal.read_text()
    for change, message in (
        (("v_length", "colour"), r"line 1: an NGSIM header with columns missing \['length'\], unknown \['colour'\]"),
        (("Local_X", "Local_Y"), r"missing \['local_x'\], unknown \[\], twice \['local_y'\]"),
    ):
        portal.write_text(content.replace(*change, 1))
        with pytest.raises(InputError, match=message):
            ngsim.convert(portal, tmp_path / "out")
    portal.write_text("1 2 3 4 5 6 7 8 9 10 11\n")
    with pytest.raises(InputError, match="line 1: 11 columns of numbers; NGSIM's text files have 18 or 24"):
        load_recording(portal)
    portal.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=r"is no Parquet; expected .* an official NGSIM file"):
        load_recording(portal)


def test_nothing_in_it(tmp_path: Path) -> None:
    portal = tmp_path / "portal.csv"
    write_portal(made().iloc[:0], portal)
    with pytest.raises(InputError, match="holds no rows"):
        ngsim.convert(portal, tmp_path / "out")


# Bounded memory


@pytest.fixture
def portal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three recordings in some forty blocks."""
    monkeypatch.setattr(reading, "BLOCK", 1 << 14)
    path = tmp_path / "portal.csv"
    parts = [made(US101, "0750"), made(US101, "0805", seed=1), made(LANKERSHIM, "0830")]
    write_portal(pd.concat(parts).sample(frac=1.0, random_state=2), path)
    return path


def test_blocks_make_no_difference(portal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    by_block = ngsim.convert(portal, tmp_path / "blocks", cleaned=False)
    monkeypatch.setattr(reading, "BLOCK", 1 << 24)
    for one, other in zip(by_block, ngsim.convert(portal, tmp_path / "whole", cleaned=False), strict=True):
        assert Recording.read(one.path).header == Recording.read(other.path).header
        pd.testing.assert_frame_equal(Recording.read(one.path).table, Recording.read(other.path).table)


def test_a_full_disk_is_named_and_leaves_nothing(portal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Recording) -> bytes:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Recording, "to_parquet", full)
    with pytest.raises(InputError, match=r"us101_0750\.parquet: cannot be written: No space left on device"):
        ngsim.convert(portal, tmp_path / "out", cleaned=False)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["out", "portal.csv"]


# Reading as a scenario does


def test_official_files_load_as_recordings(text: Path, tmp_path: Path) -> None:
    recording = load_recording(text, {"frame": [600, 700], "local_y": [50.0, 400.0], "x": [60.0, 400.0]})
    assert recording.table["frame"].between(600, 700).all()
    assert recording.table["x"].between(40.0, 400.0).all()
    with pytest.raises(InputError, match="crop names unknown column 'colour'"):
        load_recording(text, {"colour": [0, 1]})
    portal = tmp_path / "portal.csv"
    write_portal(pd.concat([made(), made(I80, "1600")]), portal)
    with pytest.raises(
        InputError, match=r"several recordings \(us101_0750, i80_1600 and maybe more\): convert it first"
    ):
        load_recording(portal)


def test_summary_counts_without_converting(portal: Path) -> None:
    said = summary(portal)
    assert "official NGSIM portal CSV, 25 columns" in said
    assert "6000 rows" in said
    assert re.search(r"us101_0805 +2000 rows, \d+ ids, 08:05:00 to 08:\d\d:\d\d local, mean speed \d+\.\d m/s", said)


# Real data, written in the official format


@pytest.mark.data
def test_the_real_window_through_the_official_format(tmp_path: Path, real_data) -> None:
    windows = real_data()
    real = pd.read_parquet(windows)
    real = real[(real["src"] < 2) & real["frame"].between(316, 543) & real["local_y_m"].between(180, 415)]
    official = pd.DataFrame({"vehicle_id": real["vehicle_id"], "frame": real["frame"], "time_ms": real["t_ms"]})
    official = official.assign(lane=real["lane_est"], location="us-101", vehicle_class=2, total_frames=0)
    official = official.assign(preceding=0, following=0, space_headway=0.0, time_headway=0.0)
    in_feet = ("local_x_m", "local_y_m", "global_x_m", "global_y_m", "length_m", "width_m")
    for name in in_feet:
        official[name.removesuffix("_m")] = real[name] / FOOT
    official["speed"], official["acceleration"] = real["speed_mps"] / FOOT, real["accel_mps2"] / FOOT
    path = tmp_path / "window.txt"
    write_text(official, path)
    here = load_recording(windows, {"frame": [316, 543], "local_y_m": [180, 415]}).table
    for cleaned, near in ((False, 0.15), (True, 0.5)):
        (one,) = ngsim.convert(path, tmp_path / f"{cleaned}.parquet", cleaned=cleaned)
        there = Recording.read(one.path)
        assert one.name == "us101_0750"
        assert one.counts.pieces == one.counts.tracks
        assert len(there.table) >= 0.999 * len(here)
        merged = here.merge(there.table, on=["vehicle_id", "frame"], suffixes=("", "_official"))
        apart = np.hypot(merged["x"] - merged["x_official"], merged["y"] - merged["y_official"])
        assert np.quantile(apart, 0.99) < near
        assert np.median(apart) < 0.1
