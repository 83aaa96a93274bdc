"""Cleaned tracks move as vehicles do, agree with themselves, and are nearer to the truth than noisy ones."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from command_line import refusal
from litsim_data import cli as data
from litsim_data.cleaning.cleaning import clean, front_centres, smoothed
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import COLUMNS, Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged

LENGTH = 4.5


def tracks(front: np.ndarray, vehicle: int = 1, first: int = 0, **columns: object) -> pd.DataFrame:
    """Tracks to clean of one vehicle with front centres (n, 2)."""
    usual = {"length": LENGTH, "width": 1.9, "kind": 0, "lane": 2}
    frame = first + np.arange(len(front))
    return pd.DataFrame({"vehicle_id": vehicle, "frame": frame, "x": front[:, 0], "y": front[:, 1], **usual, **columns})


def straight(frames: int, speed: float, acceleration: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    t = STEP_S * np.arange(frames)
    return np.outer(speed * t + 0.5 * acceleration * t**2, [np.cos(yaw), np.sin(yaw)])


def lane_change(frames: int = 120, speed: float = 13.0) -> np.ndarray:
    """A lane to the left within about four seconds, at a speed that varies."""
    t = STEP_S * np.arange(frames)
    x = speed * t + 2.0 * np.sin(0.6 * t)
    return np.column_stack([x, 3.66 / (1.0 + np.exp(-(x - x.mean()) / 8.0))])


def noise(frames: int, size: float, seed: int, lasts: float = 0.5) -> np.ndarray:
    """Positions' errors (n, 2) as tracking from video leaves them: correlated over `lasts` seconds."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-STEP_S / lasts)
    errors = rng.normal(scale=size, size=(frames, 2))
    for k in range(1, frames):
        errors[k] = keep * errors[k - 1] + np.sqrt(1.0 - keep**2) * errors[k]
    return errors


def quantised(front: np.ndarray) -> np.ndarray:
    return np.round(front / 0.03048) * 0.03048  # a tenth of a foot


def fronts(table: pd.DataFrame) -> np.ndarray:
    return front_centres(table)[["x", "y"]].to_numpy()


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


# Exact motion is kept


@settings(max_examples=20, deadline=None)
@given(speed=st.floats(1.0, 35.0), yaw=st.floats(-3.1, 3.1), frames=st.integers(5, 120), length=st.floats(2.0, 18.0))
def test_constant_velocity_is_kept(speed: float, yaw: float, frames: int, length: float) -> None:
    raw = tracks(straight(frames, speed, yaw=yaw), length=length)
    hinted = raw.assign(yaw=yaw)  # a short and slow track alone does not tell its direction otherwise
    table, report = clean(hinted)
    np.testing.assert_allclose(fronts(table), raw[["x", "y"]], atol=1e-4)
    np.testing.assert_allclose(table["speed"], speed, atol=1e-3)
    np.testing.assert_allclose(table["acceleration"], 0.0, atol=1e-3)
    np.testing.assert_allclose(table["yaw"], yaw, atol=1e-4)
    assert report.displacement[2] < 1e-4


@settings(max_examples=20, deadline=None)
@given(acceleration=st.floats(-2.5, 2.5), yaw=st.floats(-3.1, 3.1))
def test_constant_acceleration_is_kept(acceleration: float, yaw: float) -> None:
    raw = tracks(straight(60, 16.0, acceleration, yaw))
    table, _ = clean(raw)
    np.testing.assert_allclose(fronts(table), raw[["x", "y"]], atol=0.02)
    np.testing.assert_allclose(table["speed"], 16.0 + acceleration * STEP_S * np.arange(60), atol=0.06)
    np.testing.assert_allclose(table["acceleration"], acceleration, atol=0.15)  # at the ends; inside:
    np.testing.assert_allclose(table["acceleration"][15:-15], acceleration, atol=0.01)


@pytest.mark.parametrize(("radius", "speed"), [(300.0, 25.0), (80.0, 12.0), (15.0, 6.0), (-15.0, 6.0)])
def test_circles_are_kept(radius: float, speed: float) -> None:
    """The front centre on a circle: the rear axle follows on a smaller one and the vehicle points along that."""
    turn = speed / radius
    angle = turn * STEP_S * np.arange(100)
    raw = tracks(radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]))
    table, _ = clean(raw)
    reach = (0.5 + VehicleLimits.rear_axle) * LENGTH
    inside = slice(15, -15)
    assert np.linalg.norm(fronts(table) - raw[["x", "y"]], axis=1)[inside].max() < 0.02
    np.testing.assert_allclose(table["speed"][inside], speed * np.sqrt(1 - (reach / radius) ** 2), rtol=2e-3)
    yaw = np.unwrap(table["yaw"])[inside]
    np.testing.assert_allclose(yaw, angle[inside] - np.arcsin(reach / radius), atol=0.01)
    np.testing.assert_allclose(np.diff(yaw) / STEP_S, turn, rtol=0.05)


def leaving_a_bend(radius: float, speed: float, waits: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Box centres (n, 2) and headings (n,) of a vehicle that has waited within a bend, and drives on along it."""
    fine, frames = 50, 140
    t = np.arange(frames * fine) * STEP_S / fine
    pace = np.clip(2.0 * (t - waits), 0.0, speed) if waits else np.full(len(t), speed)
    gone = np.concatenate([[0.0], np.cumsum(pace) * STEP_S / fine])
    yaw = np.concatenate([[0.3], 0.3 + np.cumsum(np.diff(gone) / radius * np.clip((15.0 - gone[:-1]) / 4.0, 0.0, 1.0))])
    towards = np.column_stack([np.cos(yaw), np.sin(yaw)])
    axle = np.concatenate([np.zeros((1, 2)), np.cumsum(np.diff(gone)[:, None] * towards[:-1], axis=0)])
    return (axle + VehicleLimits.rear_axle * LENGTH * towards)[:-1:fine], yaw[:-1:fine]


@pytest.mark.parametrize(
    ("radius", "speed", "waits", "ahead"), [(12, 6, 0, 0.5), (6, 3, 0, 0.0), (-8, 1.5, 0, -0.29), (8, 6, 5, 0.0)]
)
def test_measured_headings_hold_the_ends_of_tracks_in_bends(
    radius: float, speed: float, waits: float, ahead: float
) -> None:
    centre, yaw = leaving_a_bend(radius, speed, waits)
    seen = centre + ahead * LENGTH * np.column_stack([np.cos(yaw), np.sin(yaw)])
    table = smoothed(tracks(seen, yaw=yaw), ahead=ahead, measured=True)
    apart = np.linalg.norm(table[["x", "y"]] - centre, axis=1)
    assert apart.max() < 0.14 and max(apart[0], apart[-1]) < 0.08
    assert np.abs(table["yaw"] - yaw).max() < 0.07 and np.abs(table["yaw"] - yaw)[0] < 0.05


def test_headings_of_who_stands_are_not_believed_where_it_moves() -> None:
    speed = np.concatenate([np.linspace(10, 0, 50), np.zeros(200), np.linspace(0, 10, 50)])
    gone = np.cumsum(speed) * STEP_S
    centre = np.outer(gone, [np.cos(1.0), np.sin(1.0)])
    table = smoothed(tracks(centre, yaw=np.where(speed > 0.2, 1.0, 0.0)), ahead=0.0, measured=True)
    np.testing.assert_allclose(table["yaw"], 1.0, atol=0.01)


# Symmetries


def test_the_order_of_rows_and_vehicles_is_of_no_importance() -> None:
    lanes = [
        lane_change(80, speed) + np.array([0, 4.0 * k]) + noise(80, 0.1, k) for k, speed in enumerate((9.0, 12.0, 16.0))
    ]
    standing = np.tile([30.0, 12.0], (80, 1)) + noise(80, 0.1, 9)
    all_tracks = pd.concat([tracks(front, 10 * k) for k, front in enumerate([*lanes, standing])], ignore_index=True)
    table, report = clean(all_tracks)
    shuffled, again = clean(all_tracks.sample(frac=1.0, random_state=1))
    pd.testing.assert_frame_equal(table, shuffled)
    assert report == again
    alone, _ = clean(all_tracks[all_tracks["vehicle_id"] == 10])
    pd.testing.assert_frame_equal(table[table["vehicle_id"] == 10].reset_index(drop=True), alone)


def test_a_turned_and_shifted_scene_gives_the_same_motion() -> None:
    raw = lane_change() + noise(120, 0.15, seed=6)
    c, s = np.cos(2.5), np.sin(2.5)
    turned = raw @ np.array([[c, s], [-s, c]]) + [5000.0, -3000.0]
    table, other = clean(tracks(raw))[0], clean(tracks(turned))[0]
    np.testing.assert_allclose(other["speed"], table["speed"], atol=1e-4)
    np.testing.assert_allclose(np.unwrap(other["yaw"]), np.unwrap(table["yaw"]) + 2.5, atol=1e-4)


# Standstill and slow traffic


def test_a_vehicle_that_stops_neither_creeps_nor_turns() -> None:
    """Braking at 2 m/s2, eight seconds of standstill, off again."""
    speed = np.concatenate([np.linspace(10, 0, 51), np.zeros(80), np.linspace(0, 10, 51)])
    x = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * STEP_S)])
    raw = np.column_stack([x, np.zeros_like(x)])
    for seed in range(4):
        table, _ = clean(tracks(quantised(raw + noise(len(x), 0.15, seed))))
        standing = slice(61, 121)
        assert (table["speed"][standing] == 0).all() and (table["acceleration"][standing] == 0).all()
        assert np.ptp(table["x"][standing]) < 1e-9 and np.ptp(table["yaw"][standing]) < 1e-9
        assert np.abs(table["yaw"]).max() < 0.12
        assert rms(table["speed"] - speed) < 0.35


def test_who_never_moves_points_as_those_around_or_as_published() -> None:
    moving = tracks(straight(60, 12.0, yaw=np.pi / 2) + np.array([100.0, 0.0]), 1)
    oncoming = tracks(straight(60, 12.0, yaw=-np.pi / 2) + np.array([103.0, 60.0]), 2, lane=7)
    standing = tracks(np.tile([102.5, 30.0], (60, 1)) + noise(60, 0.15, 2), 3)
    table, _ = clean(pd.concat([moving, oncoming, standing]))
    mine = table[table["vehicle_id"] == 3]
    np.testing.assert_allclose(mine["yaw"], np.pi / 2, atol=0.1)  # of the same lane, though another is nearer
    assert (mine["speed"] == 0).all()
    table, _ = clean(standing.assign(yaw=2.0))
    np.testing.assert_allclose(table["yaw"], 2.0, atol=0.1)
    assert np.isfinite(clean(standing)[0].to_numpy(float)).all()


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 6])
def test_short_tracks(frames: int) -> None:
    front = straight(frames, 12.0) + noise(frames, 0.05, 1, lasts=5.0)
    table, report = clean(tracks(front, speed=12.0, acceleration=0.0))
    Recording.from_table(RecordingHeader("made"), table, "made")
    np.testing.assert_allclose(table["speed"], 12.0, atol=0.7)
    np.testing.assert_allclose(table["yaw"], 0.0, atol=0.1)
    assert report.rows == frames and report.displacement[2] < 0.15


# Noise


def test_an_outlier_does_not_move_the_track() -> None:
    raw = straight(80, 12.0)
    spoiled = raw.copy()
    spoiled[40] += [4.0, -2.0]
    spoiled[60:63] += [0.0, 1.5]
    table, _ = clean(tracks(spoiled))
    assert np.linalg.norm(fronts(table) - raw, axis=1).max() < 0.15
    assert np.abs(table["acceleration"]).max() < 0.5


@pytest.mark.parametrize(
    ("size", "lasts", "position", "speed", "acceleration", "yaw"),
    [(0.2, 0.05, 0.11, 0.13, 0.30, 0.015), (0.3, 0.5, 0.34, 0.28, 0.42, 0.032)],
)
def test_cleaned_tracks_are_near_the_truth(
    size: float, lasts: float, position: float, speed: float, acceleration: float, yaw: float
) -> None:
    """The packaged recording, made noisy: root mean square errors [m], [m/s], [m/s2], [rad]."""
    truth = load_recording(packaged("scenarios/us101_like.parquet")).table
    truth = truth[truth["vehicle_id"] % 4 == 0].sort_values(["vehicle_id", "frame"], ignore_index=True)
    raw = front_centres(truth).drop(columns=["yaw", "speed", "acceleration"])
    for vehicle, rows in raw.groupby("vehicle_id"):
        raw.loc[rows.index, ["x", "y"]] = quantised(
            rows[["x", "y"]].to_numpy() + noise(len(rows), size, int(vehicle), lasts)  # type: ignore[call-overload]
        )
    table, report = clean(raw)
    table = table.sort_values(["vehicle_id", "frame"], ignore_index=True)
    assert rms(np.hypot(table["x"] - truth["x"], table["y"] - truth["y"])) < position
    assert rms(table["speed"] - truth["speed"]) < speed
    assert rms(table["acceleration"] - truth["acceleration"]) < acceleration
    assert rms(table["yaw"] - truth["yaw"]) < yaw
    assert report.raw > 0.5 and report.cleaned < 0.005


def test_derivatives_agree_with_positions() -> None:
    """Speed, acceleration and yaw against differences of the table's own positions."""
    table, _ = clean(tracks(lane_change() + noise(120, 0.2, seed=4)))
    yaw, speed = np.unwrap(table["yaw"]), table["speed"].to_numpy()
    lever = VehicleLimits.rear_axle * LENGTH
    axle = table[["x", "y"]].to_numpy() - lever * np.column_stack([np.cos(yaw), np.sin(yaw)])
    np.testing.assert_allclose(np.diff(speed) / STEP_S, _means(table["acceleration"].to_numpy()), atol=0.01)
    steps = np.diff(axle, axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1) / STEP_S, _means(speed), atol=0.01)
    np.testing.assert_allclose(np.arctan2(steps[:, 1], steps[:, 0]), _means(yaw), atol=1e-3)
    assert list(table.columns) == list(COLUMNS)


def _means(values: np.ndarray) -> np.ndarray:
    return 0.5 * (values[1:] + values[:-1])


# The report


def test_the_report_counts_overlaps_before_and_after() -> None:
    front = straight(40, 12.0)
    near = front + np.array([0.0, 2.0])
    near[20:22, 1] = 1.0  # jumps into its neighbour and back
    _, report = clean(pd.concat([tracks(front, 1), tracks(near, 2)]))
    assert report.overlaps == ((1, 2), (0, 0))
    assert report.published is None
    text = report.table()
    assert "80 rows of 2 vehicles" in text and "pairs of overlapping boxes" in text


def test_the_report_tells_published_from_raw_figures() -> None:
    spiky = np.where(np.arange(50) % 5 == 0, 4.0, 0.0)
    _, report = clean(tracks(straight(50, 10.0), acceleration=spiky))
    assert (report.published, report.raw, report.cleaned) == (pytest.approx(0.2), 0.0, 0.0)


# Input that cannot be used


def test_tracks_that_cannot_be_used() -> None:
    table = tracks(straight(10, 10.0))
    with pytest.raises(InputError, match="vehicle_id 1: frame 4 is followed by a jump of more than 60 m"):
        clean(table.assign(x=table["x"].where(table["frame"] < 5, 500.0)))


# `data clean`


def test_clean_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, _ = clean(
        pd.concat([tracks(lane_change() + noise(120, 0.1, 1), 1), tracks(straight(50, 9.0) + np.array([0, 30]), 2)])
    )
    source, out = tmp_path / "in.parquet", tmp_path / "out.parquet"
    Recording.from_table(RecordingHeader("made", net="made.net.xml"), table, "made").write(source)
    data.main(["clean", str(source), str(out), "--lateral-period", "2.5"])
    text = capsys.readouterr().out
    assert "170 rows of 2 vehicles" in text and "front centres moved by" in text
    cleaned = Recording.read(out)
    assert cleaned.header.net == "made.net.xml"
    assert cleaned.header.notes["cleaned"]["lateral_period_s"] == 2.5  # type: ignore[index]
    assert "was cleaned before" in refusal(capsys, data.main, "clean", out, source)
    assert "expected a positive number" in refusal(capsys, data.main, "clean", source, out, "--lateral-period", 0)


@pytest.mark.data
def test_the_real_window(real_data) -> None:
    recording = load_recording(real_data(), {"frame": [316, 543], "local_y_m": [180, 415]})
    table, report = clean(front_centres(recording.table))
    assert Recording.from_table(recording.header, table, "cleaned").table["vehicle_id"].nunique() == 108
    assert report.published is not None and report.published > 0.08 and report.cleaned < 0.001
    assert report.displacement[0] < 0.1 and report.displacement[1] < 0.3
    assert report.overlaps == ((0, 0), (0, 0))
