"""Generated traffic on both nets: motion that vehicles can make, no contacts, everything repeatable."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest

from litsim_data import cli as data
from litsim_data.segments import Manifest
from litsim_data.traffic import synthetic
from litsim_data.traffic.drivers import draw_vehicle, vehicle_type
from litsim_data.traffic.motion import Smoothness, smooth, smooth_motion
from litsim_data.traffic.sites import ENTRIES, SITES, URBAN_LIKE, US101_LIKE
from litsim_data.traffic.synthetic import DECIMALS, synthesize, synthesize_segments
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import overlapping_pairs, wrap_angle
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.signals import STOP_STATES
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import crossings, read_links
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import Scenario, packaged
from litsim_sim.scenario.signals import SignalsFile, build


@cache
def traffic_on(site: str) -> Recording:
    return synthesize(5, 40.0, SITES[site])


@pytest.fixture(scope="module", params=sorted(SITES))
def made(request: pytest.FixtureRequest) -> Recording:
    return traffic_on(request.param)


# Motion of one vehicle


def straight(speed: np.ndarray, heading: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    way = np.concatenate([[0.0], np.cumsum(speed[1:] * STEP_S)])
    return np.outer(way, [np.cos(heading), np.sin(heading)]), speed


def test_the_box_centre_follows_half_a_length_behind() -> None:
    front, speed = straight(np.full(100, 10.0), 0.5)
    motion = smooth_motion(front, speed, 5.0, Smoothness(6.0))
    assert motion is not None
    np.testing.assert_allclose(motion.x, front[:, 0] - 2.5 * np.cos(0.5), atol=1e-6)
    np.testing.assert_allclose(motion.yaw, 0.5, atol=1e-9)
    np.testing.assert_allclose(motion.speed, 10.0, atol=1e-6)


def test_offsets_are_to_the_left() -> None:
    front, speed = straight(np.full(100, 10.0), np.pi / 2)
    motion = smooth_motion(front, speed, 5.0, Smoothness(6.0, offset=0.4))
    assert motion is not None
    np.testing.assert_allclose(motion.x, -0.4, atol=1e-6)


def test_sliding_sideways_at_standstill_becomes_a_lane_change_on_the_way() -> None:
    speed = np.concatenate([np.full(60, 5.0), np.zeros(60), np.full(60, 5.0)])
    front, _ = straight(speed)
    front[70:, 1] += np.minimum(np.arange(110) * 0.1, 3.3)
    motion = smooth_motion(front, speed, 4.5, Smoothness(6.0))
    assert motion is not None
    standing = motion.speed < 1e-6
    assert standing.sum() > 20
    assert np.ptp(motion.y[standing]) < 1e-9 and np.ptp(motion.yaw[standing]) < 1e-9
    assert np.abs(motion.yaw).max() < 0.3
    assert motion.y[-1] == pytest.approx(3.3, abs=0.05)


def test_corners_are_not_cut() -> None:
    """A left turn of 10 m radius between straights, as on a junction."""
    angle = np.linspace(0.0, np.pi / 2, 32)
    arc = np.column_stack([10.0 * np.sin(angle), 10.0 - 10.0 * np.cos(angle)])
    line = np.concatenate([np.column_stack([np.arange(-40.0, 0.0, 0.5), np.zeros(80)]), arc])
    line = np.concatenate([line, np.column_stack([np.full(80, 10.0), 10.5 + np.arange(0.0, 40.0, 0.5)])])
    speed = np.full(len(line), 5.0)
    motion = smooth_motion(line, speed, 4.5, Smoothness(6.0))
    assert motion is not None
    centre = np.array([0.0, 10.0])
    turning = (motion.x > 1.0) & (motion.y < 9.0)
    radius = np.hypot(motion.x - centre[0], motion.y - centre[1])[turning]
    assert np.abs(radius - 10.0).max() < 0.6
    assert motion.yaw[-1] == pytest.approx(np.pi / 2, abs=0.02)


def test_vehicles_that_hardly_move_have_no_motion() -> None:
    assert smooth_motion(np.zeros((50, 2)), np.zeros(50), 4.5, Smoothness(6.0)) is None
    assert smooth_motion(np.zeros((1, 2)), np.zeros(1), 4.5, Smoothness(6.0)) is None


def test_unsteady_drivers_never_go_back_and_stand_still() -> None:
    front, speed = straight(np.concatenate([np.full(100, 12.0), np.linspace(12.0, 0.0, 50), np.zeros(50)]))
    motion = smooth_motion(front, speed, 4.5, Smoothness(6.0, unsteadiness=0.4, seed=3))
    assert motion is not None
    assert (np.diff(motion.x) >= -1e-9).all()
    assert np.ptp(motion.x[-30:]) < 0.02
    assert 0.1 < motion.acceleration[10:90].std() < 0.8


def test_smoothing_keeps_straight_lines() -> None:
    np.testing.assert_allclose(smooth(np.arange(50.0), 4.0), np.arange(50.0), atol=1e-9)


# Traffic


def test_motion_is_sound(made: Recording) -> None:
    table = made.table.sort_values(["vehicle_id", "frame"])
    same = np.diff(table["vehicle_id"]) == 0
    dx, dy = (np.diff(table[name])[same] for name in ("x", "y"))
    dyaw = wrap_angle(np.diff(table["yaw"]))[same]
    speed, acceleration, yaw = (table[name].to_numpy() for name in ("speed", "acceleration", "yaw"))
    moved, mean_speed = np.hypot(dx, dy), (0.5 * (speed[1:] + speed[:-1]))[same]
    np.testing.assert_allclose(moved / STEP_S, mean_speed, atol=0.01)
    np.testing.assert_allclose(
        np.diff(speed)[same] / STEP_S, (0.5 * (acceleration[1:] + acceleration[:-1]))[same], atol=0.6
    )
    along = wrap_angle(np.arctan2(dy, dx) - (yaw[:-1][same] + 0.5 * dyaw))
    np.testing.assert_allclose(along[moved > 0.1], 0.0, atol=8e-3)  # no slip
    assert (np.abs(dyaw) <= 0.2 * moved + 2 * 10.0 ** -DECIMALS["yaw"]).all()  # turning takes way: none at standstill
    assert (np.abs(dyaw) / STEP_S).max() < 1.0
    assert table["acceleration"].between(-7.0, 3.5).all()


def test_nobody_touches_anybody(made: Recording) -> None:
    boxes = (made.table[name].to_numpy() for name in ("x", "y", "yaw", "length", "width", "frame"))
    assert not len(overlapping_pairs(*boxes))


def test_a_vehicle_that_was_left_out_does_not_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Vehicle 1 touches 0 and 2; in the round in which it is left out for 0, only 2 can still be centred."""
    rounds: list[set[int]] = []

    def touching(table: pd.DataFrame) -> list[tuple[int, int]]:
        rounds.append(set(table["vehicle_id"].tolist()))
        return [pair for pair in ([(0, 1)], [(0, 1), (1, 2)])[len(rounds) > 1] if set(pair) <= rounds[-1]]

    def track(site: object, observation: object, vehicle: int, seed: int, seconds: float, **_: object) -> pd.DataFrame:
        return pd.DataFrame({"vehicle_id": [vehicle], "frame": [0], "x": [10.0 * vehicle]})

    monkeypatch.setattr(synthetic, "observe", lambda *_: SimpleNamespace(vehicles=[0, 1, 2]))
    monkeypatch.setattr(synthetic, "overlaps", touching)
    monkeypatch.setattr(synthetic, "_track", track)
    monkeypatch.setattr(synthetic, "_signals", lambda *_: {})
    monkeypatch.setattr(synthetic, "_lane_from_left", lambda *_: 1)
    monkeypatch.setattr(synthetic, "Recording", SimpleNamespace(from_table=lambda header, table, _: (header, table)))
    header, table = synthetic._record(US101_LIKE, 1, 28.0)
    assert rounds[-1] == {0, 2} and header.notes["left_out"] == 1 and len(table) == 2


def test_everybody_is_on_the_road_and_in_the_window(made: Recording) -> None:
    site = SITES[made.header.name]
    x, y = made.table["x"].to_numpy(), made.table["y"].to_numpy()
    assert LaneMap.from_net(site.net).inside_road(x, y).mean() > 0.999
    x_min, y_min, x_max, y_max = site.window
    assert x.min() >= x_min - 1e-6 and x.max() <= x_max + 1e-6 and y.min() >= y_min - 1e-6 and y.max() <= y_max + 1e-6


def test_packaged_recordings_say_of_themselves_what_the_generator_writes() -> None:
    made = traffic_on(US101_LIKE.name).header
    assert "." not in made.source  # a module's path would not outlive the next move
    for name in ("us101_like", "demo"):
        embedded = Recording.read(packaged(f"scenarios/{name}.parquet")).header
        assert embedded.source == made.source
        assert embedded.notes["traffic"] == made.notes["traffic"]
        assert (embedded.name, embedded.licence, embedded.net) == (made.name, made.licence, made.net)


def _at_red(made: Recording) -> float:
    """Share of the vehicles that pass the stop lines of the signals that a recording carries while they show red."""
    frames = int(made.table["frame"].max()) + 1
    log = Log.from_recording(made, 0, frames)
    signals = build(SignalsFile.model_validate(made.header.signals), URBAN_LIKE.net, log, 0, "made")
    assert len(signals.links) == 28, "every controlled connection of the net"
    found = crossings(signals.links, log.x, log.y, log.yaw, log.length, log.valid)
    assert len(found.agent) > 20
    return float(np.isin(signals.states[signals.link_group[found.link], found.step], STOP_STATES).mean())


def test_urban_traffic_queues_and_turns() -> None:
    made = traffic_on(URBAN_LIKE.name)
    table = made.table
    assert ((table["speed"] < 0.1).groupby(table["frame"]).sum() > 2).mean() > 0.5, "queues stand at the signals"
    assert table["speed"].max() < 20.0
    turned = table.groupby("vehicle_id")["yaw"].agg(lambda yaw: float(np.ptp(np.unwrap(yaw))))
    assert (turned > 1.4).sum() > 5, "some turn at the junctions"
    assert -1 in set(table["lane"]), "inside junctions there are no lanes to count"
    assert _at_red(made) < 0.1


def test_routes_hold_the_demand() -> None:
    assert sum(route.flow for route in URBAN_LIKE.routes) == pytest.approx(sum(ENTRIES.values()))
    edges = {lane.edge_id for lane in LaneMap.from_net(URBAN_LIKE.net).lanes}
    assert all(set(route.edges) <= edges for route in URBAN_LIKE.routes)


def test_drivers_differ() -> None:
    rng, fleet = np.random.default_rng(0), US101_LIKE.fleet
    assert len({vehicle_type(draw_vehicle(fleet, rng), fleet, rng)["tau"] for _ in range(20)}) > 10


# The urban net


def test_movements_of_the_net_have_green_with_their_street() -> None:
    """Not only those of the plan: netconvert numbers links anew where it may."""
    phases = {
        logic.get("id"): [phase.get("state", "") for phase in logic]
        for logic in ET.parse(URBAN_LIKE.net).getroot().findall("tlLogic")
    }
    links = read_links(URBAN_LIKE.net)
    assert len(links) == 28
    for link in links:
        main = abs(np.sin(link.heading)) < 0.5
        left = np.sin(link.exit_heading - link.heading) > 0.5
        green = [at for at, state in enumerate(phases[link.light]) if state[link.index] in "Gg"]
        assert green == [0 if main else 3], link.name
        assert phases[link.light][green[0]][link.index] == ("g" if left else "G"), link.name


# Sets with segments


def test_a_set_of_segments_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data.main(["synthesize", "--net", "urban_like", "--segments", "2", "--seed", "3", "--out", str(tmp_path)])
    assert "segments of 1 recordings" in capsys.readouterr().out
    manifest = Manifest.read(tmp_path / "manifest.yaml")
    for segment in manifest.segments:
        scenario = Scenario.load(tmp_path / f"{segment.name}.yaml")
        assert scenario.ego_id == segment.ego
    assert Recording.read(tmp_path / "urban_like_3_0.parquet").header.net == "urban_like.net.xml"


def test_no_segments() -> None:
    with pytest.raises(InputError, match="0 segments"):
        synthesize_segments(US101_LIKE, 0, 1)
