"""Official NGSIM files: both formats, every defect with its line."""

import errno
import os
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from litsim_data.generic.counts import Counts
from litsim_data.generic.mapping import FOOT
from litsim_data.ngsim import reading
from litsim_data.ngsim.sites import I80, LANKERSHIM, PEACHTREE, SITES, US101, site_at, site_of
from litsim_data.sources.conversion import converted as as_recording
from litsim_data.sources.importing import Options, files_of, import_all
from litsim_data.sources.ngsim import Official
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording
from made_ngsim import global_from_map, table, write_portal, write_text

LANE = 3.66  # [m]

made = partial(table, noise=0.0)


@pytest.fixture
def text(tmp_path: Path) -> Path:
    """A small motorway file."""
    return write_text(made(), tmp_path / "trajectories-0750am-0805am.txt")


def every(path: Path, *, cleaned: bool = False) -> list[tuple[Recording, Counts]]:
    """The recordings that a file holds, with the counts of their conversion."""
    source = Official()
    return [as_recording(scene, source, raw=not cleaned) for scene in source.read(path, None)]


def only(path: Path, *, cleaned: bool = False) -> tuple[Recording, Counts]:
    """The one recording that comes out of a conversion, and its counts."""
    (one,) = every(path, cleaned=cleaned)
    return one


def raw(path: Path) -> Recording:
    """The one recording that comes out of a conversion without cleaning."""
    return only(path)[0]


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
    recording = raw(text)
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
    portal = write_portal(made().sample(frac=1.0, random_state=0), tmp_path / "portal.csv", commas=commas)
    pd.testing.assert_frame_equal(raw(portal).table, raw(text).table, atol=1e-9, rtol=0.0)


def test_headers_in_other_spelling_and_order(text: Path, tmp_path: Path) -> None:
    portal = write_portal(made(), tmp_path / "portal.csv", commas=False)
    given = pd.read_csv(portal).rename(columns={"Space_Headway": "Space_Hdwy", "Time_Headway": "time hdwy"})
    given = given[reversed(given.columns)].rename(columns=str.upper)
    other = tmp_path / "other.csv"
    given.to_csv(other, index=False, sep=";", lineterminator="\r\n", encoding="utf-8-sig")
    pd.testing.assert_frame_equal(raw(other).table, raw(text).table, atol=1e-9, rtol=0.0)


def test_streets_keep_both_directions(tmp_path: Path) -> None:
    path = write_text(made(LANKERSHIM, "0830"), tmp_path / "lankershim.txt")
    recording = raw(path)
    assert recording.header.name == "lankershim_0830"
    yaw = recording.table["yaw"].to_numpy()
    assert (np.abs(yaw) < 0.01).any() and (np.abs(np.abs(yaw) - np.pi) < 0.01).any()
    assert ((np.abs(yaw) < 0.01) | (np.abs(np.abs(yaw) - np.pi) < 0.01)).all()


def test_every_site_and_period_is_a_recording(tmp_path: Path) -> None:
    parts = [made(US101, "0750"), made(US101, "0805", seed=1), made(I80, "1700"), made(PEACHTREE, "1600")]
    portal = write_portal(pd.concat(parts).sample(frac=1.0, random_state=1), tmp_path / "portal.csv")
    converted = every(portal)
    names = [recording.header.name for recording, _ in converted]
    assert names == ["us101_0750", "us101_0805", "i80_1700", "peachtree_1600"]
    for (recording, counts), part in zip(converted, parts, strict=True):  # ids are given anew in every period
        assert len(np.unique(recording.columns["vehicle_id"])) == part["vehicle_id"].nunique()
        assert counts.rows == len(part)


def test_one_clock_through_two_periods(tmp_path: Path) -> None:
    late = made(I80, "1700")
    late = late.assign(frame=late["frame"] + 36000)
    late["time_ms"] = made(I80, "1600")["time_ms"].min() + 100 * (late["frame"] - made(I80, "1600")["frame"].min())
    portal = write_portal(pd.concat([made(I80, "1600"), late]), tmp_path / "portal.csv")
    assert [recording.header.name for recording, _ in every(portal)] == ["i80_1600", "i80_1700"]


def test_cleaned_positions_stay_close_and_motion_is_smooth(tmp_path: Path) -> None:
    path = write_text(made(noise=0.05), tmp_path / "noisy.txt")
    recording, _ = only(path, cleaned=True)
    assert recording.header.notes["cleaned"] is True
    cleaned = recording.table
    assert (cleaned["acceleration"].abs() < 3.0).mean() > 0.99
    merged = cleaned.merge(made(), on=["vehicle_id", "frame"], suffixes=("", "_ft"))
    front = merged["x"] + 0.5 * merged["length"] * np.cos(merged["yaw"])
    assert (front - merged["local_y"] * FOOT).abs().median() < 0.1


# What is mended


def test_one_refused_recording_does_not_keep_the_others(tmp_path: Path) -> None:
    bad = made(I80, "1600")
    bad.loc[100:160, "global_x"] += 30.0
    portal = write_portal(pd.concat([bad, made(I80, "1600"), made(US101, "0750")]), tmp_path / "portal.csv")
    us101, i80 = import_all(files_of(portal), tmp_path / "out", Options())
    assert not isinstance(us101, str) and us101.name == "us101_0750"
    assert isinstance(i80, str) and re.search(r"lines \d+ and \d+: vehicle \d+ occurs twice at", i80)


def test_contradicting_rows_are_left_out_or_refused(tmp_path: Path) -> None:
    rows = made()
    wrong = rows.iloc[[100]].assign(global_x=lambda r: r["global_x"] + 30.0)
    path = write_text(pd.concat([rows, wrong]), tmp_path / "two places.txt")
    _recording, counts = only(path)
    assert counts.left_out == {"another row has the same vehicle and time, and other values": 2}
    assert counts.rows == len(rows), "interpolated"
    many = rows.iloc[100:160].assign(global_x=lambda r: r["global_x"] + 30.0)
    write_text(pd.concat([rows, many]), path)
    with pytest.raises(InputError, match=r"two places.txt: lines 101 and 2001: vehicle \d+ occurs twice"):
        only(path)


def test_a_vehicle_without_size_gets_the_usual_one(text: Path, tmp_path: Path) -> None:
    rows = made()
    rows.loc[rows["vehicle_id"] == 1, "width"] = 0.0
    write_text(rows, text)
    recording, _counts = only(text)
    table = recording.table
    assert table.loc[table["vehicle_id"] == 1, "width"].unique().tolist() == [1.9]


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
        only(edited(text, change))
    assert sorted(path.name for path in tmp_path.iterdir()) == [text.name]


def test_the_line_is_right_in_later_blocks_and_after_empty_lines(
    text: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "BLOCK", 4096)
    edited(text, put(1500, 11, "fast"))
    with pytest.raises(InputError, match="line 1500: column v_Vel"):
        only(text)
    edited(text, lambda lines: lines.insert(1480, ""))
    with pytest.raises(InputError, match="line 1501: column v_Vel"):
        only(text)
    edited(text, lambda lines: lines.insert(100, ""))
    with pytest.raises(InputError, match="line 1502: column v_Vel"):
        only(text)


def test_a_quotation_mark_swallows_no_lines(tmp_path: Path) -> None:
    portal = write_portal(made(), tmp_path / "portal.csv", commas=False)
    for line in (6, 8):
        edited(portal, lambda lines, at=line - 1: lines.__setitem__(at, lines[at].replace(",", ',"', 1)))
    with pytest.raises(InputError, match=r"line 6: a quotation mark that is not closed in this line|line 6: "):
        only(portal)


def test_metres_are_refused(text: Path, tmp_path: Path) -> None:
    rows = made()
    sizes = rows.assign(length=rows["length"] * FOOT, width=rows["width"] * FOOT)
    write_text(sizes, text)
    with pytest.raises(InputError, match=r"line 1 and after: column v_Length has median 4\.\d+, .* looks like metres"):
        only(text)
    places = rows.assign(global_x=rows["global_x"] * FOOT, global_y=rows["global_y"] * FOOT)
    write_text(places, text)
    with pytest.raises(InputError, match=r"line 1: Global_X, Global_Y are .* these are metres"):
        only(text)


def test_a_file_that_is_cut_off(text: Path, tmp_path: Path) -> None:
    whole = text.read_text()
    text.write_text(whole.rstrip())  # only the last end of line is missing: nothing is lost
    rows = len(raw(text).table)
    last = whole.rstrip().rpartition("\n")[2]
    assert rows == 2000
    text.write_text(whole.rstrip()[: -len(last) // 2])
    with pytest.raises(InputError, match=r"line 2000: \d+ columns, expected 18: .*; the file ends within this line"):
        only(text)


def test_frames_at_another_rate(text: Path, tmp_path: Path) -> None:
    rows = made(rows_wanted=8000)
    write_text(rows.assign(time_ms=rows["time_ms"].min() + 3000 * (rows["frame"] - rows["frame"].min())), text)
    with pytest.raises(InputError, match=r"line \d+: Frame_ID \d+ at Global_Time \d+: .* do not run together at 10 Hz"):
        only(text)


def test_an_unknown_place(tmp_path: Path) -> None:
    rows = made()
    rows.loc[3, "location"] = "us-66"
    portal = write_portal(rows, tmp_path / "portal.csv")
    with pytest.raises(InputError, match="line 5: column Location is 'us-66', expected one of us-101, i-80, "):
        only(portal)


def test_a_few_rows_off_the_site_are_left_out(text: Path, tmp_path: Path) -> None:
    _, counts = only(edited(text, put(50, 6, "0")))
    assert counts.rows == len(made()) and list(counts.left_out.values()) == [1]
    assert "global_x is not within" in counts.text()


def test_headers_with_defects(tmp_path: Path) -> None:
    portal = write_portal(made(), tmp_path / "portal.csv")
    content = portal.read_text()
    for change, message in (
        (("v_length", "colour"), r"line 1: an NGSIM header with columns missing \['length'\], unknown \['colour'\]"),
        (("Local_X", "Local_Y"), r"missing \['local_x'\], unknown \[\], twice \['local_y'\]"),
    ):
        portal.write_text(content.replace(*change, 1))
        with pytest.raises(InputError, match=message):
            only(portal)
    portal.write_text("1 2 3 4 5 6 7 8 9 10 11\n")
    with pytest.raises(InputError, match="line 1: 11 columns of numbers; NGSIM's text files have 18 or 24"):
        load_recording(portal)
    portal.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=r"is no Parquet; expected .* an official NGSIM file"):
        load_recording(portal)


def test_nothing_in_it(tmp_path: Path) -> None:
    portal = write_portal(made().iloc[:0], tmp_path / "portal.csv")
    with pytest.raises(InputError, match="holds no rows"):
        only(portal)


# Bounded memory


@pytest.fixture
def portal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three recordings in some forty blocks."""
    monkeypatch.setattr(reading, "BLOCK", 1 << 14)
    parts = [made(US101, "0750"), made(US101, "0805", seed=1), made(LANKERSHIM, "0830")]
    return write_portal(pd.concat(parts).sample(frac=1.0, random_state=2), tmp_path / "portal.csv")


def test_blocks_make_no_difference(portal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    by_block = every(portal)
    monkeypatch.setattr(reading, "BLOCK", 1 << 24)
    for (one, _), (other, _) in zip(by_block, every(portal), strict=True):
        assert one.header == other.header
        pd.testing.assert_frame_equal(one.table, other.table)


def test_a_full_disk_is_named_and_leaves_nothing(portal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Recording) -> bytes:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Recording, "parquet", property(full))
    first = next(import_all(files_of(portal), tmp_path / "out", Options()))
    assert isinstance(first, str) and "us101_0750.parquet: cannot be written: No space left on device" in first
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["out", "portal.csv"]


# Reading as a scenario does


def test_official_files_load_as_recordings(text: Path, tmp_path: Path) -> None:
    recording = load_recording(text, {"frame": [600, 700], "local_y": [60.0, 400.0]})
    assert recording.table["frame"].between(600, 700).all()
    assert recording.table["x"].between(40.0, 400.0).all()
    with pytest.raises(InputError, match=r"no columns \['colour'\]; these can be used: .*'local_y'"):
        load_recording(text, {"colour": [0, 1]})
    portal = write_portal(pd.concat([made(), made(I80, "1600")]), tmp_path / "portal.csv")
    with pytest.raises(
        InputError, match=r"several recordings \(us101_0750, i80_1600 and maybe more\): import it first"
    ):
        load_recording(portal)


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
    path = write_text(official, tmp_path / "window.txt")
    here = load_recording(windows, {"frame": [316, 543], "local_y_m": [180, 415]}).table
    for cleaned, near in ((False, 0.15), (True, 0.5)):
        there, counts = only(path, cleaned=cleaned)
        assert there.header.name == "us101_0750"
        assert counts.pieces == counts.tracks
        assert len(there.table) >= 0.999 * len(here)
        merged = here.merge(there.table, on=["vehicle_id", "frame"], suffixes=("", "_official"))
        apart = np.hypot(merged["x"] - merged["x_official"], merged["y"] - merged["y_official"])
        assert np.quantile(apart, 0.99) < near
        assert np.median(apart) < 0.1
