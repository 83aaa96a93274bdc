"""Motorway nets: fitting under labels and lateral coordinates, published geometry, and the checks of nets."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import made_ngsim
from litsim_data.cli import main
from litsim_data.maps.cad import CenterLine, read_center_lines
from litsim_data.maps.check import cad_distance, check_net
from litsim_data.maps.connectivity import connectivity
from litsim_data.maps.fitting import LAYOUTS, Layout, fit_generic_plan, fit_plan, lane_widths
from litsim_data.maps.netconvert import find_netconvert
from litsim_data.maps.placement import lane_numbers
from litsim_data.maps.positions import for_checking, for_fitting
from litsim_data.ngsim.sites import FOOT, SITES
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.recording import COLUMNS, Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged
from made_lanes import made_lane

WIDTHS = np.array([3.7, 3.5, 3.4, 3.6, 3.6])
CENTRES = np.cumsum(WIDTHS) - 0.5 * WIDTHS


@pytest.fixture
def netconvert() -> None:
    try:
        find_netconvert()
    except InputError as error:
        pytest.skip(str(error))


def bend(x: np.ndarray) -> np.ndarray:
    """y of the left edge of a made road."""
    return 3.0 - 1e-4 * (x - 300.0) ** 2


def positions(rng: np.random.Generator, aside: float = 0.0, n: int = 8000) -> pd.DataFrame:
    """Vehicles on a made road like US-101, `aside` metres to the right of the middle of their lanes."""
    lane = rng.integers(1, 6, n)
    x = rng.uniform(0.0, 600.0, n)
    right = CENTRES[lane - 1] + aside + rng.normal(0.0, 0.3, n)
    ramp_x = np.concatenate([rng.uniform(120, 177, 300), rng.uniform(177, 388, 300), rng.uniform(388, 450, 300)])
    away = np.maximum(np.maximum(177.0 - ramp_x, ramp_x - 388.0), 0.0)
    x, lane = np.concatenate([x, ramp_x]), np.concatenate([lane, np.full(900, 6)])
    right = np.concatenate([right, WIDTHS.sum() + 1.83 + aside + 0.05 * away])
    y = bend(x) - right * np.sqrt(1 + (2e-4 * (x - 300)) ** 2)
    table = pd.DataFrame({"x": x, "y": y, "yaw": np.arctan(-2e-4 * (x - 300)), "lane": lane})
    return table.assign(front_x=x, front_y=y, local_x=1.011 * right)


# Fitting


def test_lateral_coordinates_place_the_lanes_that_vehicles_do_not_keep_to() -> None:
    table = positions(np.random.default_rng(1), aside=0.5)
    by_edge, by_middle = (fit_plan(t, LAYOUTS["us101"]) for t in (table, table.drop(columns="local_x")))
    for plan, off in ((by_edge, 0.0), (by_middle, -0.5)):
        inner = plan.left_edge[(plan.left_edge[:, 0] > 0) & (plan.left_edge[:, 0] < 590)]
        assert np.abs(inner[:, 1] - bend(inner[:, 0]) - off).mean() < 0.1
        np.testing.assert_allclose(np.cumsum(plan.widths) - 0.5 * np.array(plan.widths), CENTRES, atol=0.1)
        assert plan.on_ramp is not None and plan.on_ramp.taper == pytest.approx(0.05, abs=0.005)
        assert plan.off_ramp is not None and plan.off_ramp.taper == pytest.approx(0.05, abs=0.005)


def test_widths_reproduce_the_distances_of_lanes() -> None:
    offsets = np.array([0.0, 3.6, 7.0, 10.4, 14.0])
    widths = lane_widths(offsets)
    np.testing.assert_allclose(0.5 * (widths[1:] + widths[:-1]), np.diff(offsets))
    assert lane_widths(np.array([0.0]))[0] == pytest.approx(3.66)


@pytest.mark.parametrize("heading", [0.0, 2.0, -1.5])
def test_generic_carriageway_in_any_direction(heading: float) -> None:
    table = positions(np.random.default_rng(3))
    cos, sin = np.cos(heading), np.sin(heading)
    turned = table.assign(
        x=cos * table["x"] - sin * table["y"], y=sin * table["x"] + cos * table["y"], yaw=table["yaw"] + heading
    )
    plan = fit_generic_plan(turned)
    assert plan.lanes == 6 and plan.on_ramp is None
    back = plan.left_edge @ np.array([[cos, -sin], [sin, cos]])
    inner = back[(back[:, 0] > 0) & (back[:, 0] < 590)]
    assert np.abs(inner[:, 1] - bend(inner[:, 0])).mean() < 0.2


def test_recordings_that_do_not_allow_a_fit() -> None:
    table = positions(np.random.default_rng(4))
    with pytest.raises(InputError, match="has no lane numbers"):
        fit_generic_plan(table.assign(lane=-1))
    with pytest.raises(InputError, match="headings differ by more than 60 degrees"):
        fit_generic_plan(table.assign(yaw=np.where(np.arange(len(table)) % 2, 0.0, np.pi)))
    with pytest.raises(InputError, match="cannot fit a ramp: 0 rows"):
        fit_plan(table[table["lane"] <= 5], LAYOUTS["us101"])
    with pytest.raises(InputError, match="cannot fit lanes 1 to 7"):
        fit_plan(table, Layout(lanes=7))


# Through the command


@pytest.mark.usefixtures("netconvert")
def test_generic_recording_through_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = positions(np.random.default_rng(5), n=4000)
    made = made[made["lane"] <= 5].reset_index(drop=True)
    table = made.assign(vehicle_id=np.arange(len(made)), frame=0, speed=10.0, acceleration=0.0, length=4.5, width=1.8)
    Recording.from_table(RecordingHeader("made"), table.assign(kind=0)[list(COLUMNS)], "made").write(
        tmp_path / "r.parquet"
    )
    net = str(tmp_path / "r.net.xml")
    main(["map", "--recording", str(tmp_path / "r.parquet"), "--out", net])
    main(["map", "--check", net, "--recording", str(tmp_path / "r.parquet")])
    assert "SUMO: loads without warnings" in capsys.readouterr().out
    assert len(LaneMap.from_net(Path(net)).lanes) == 5


def test_official_files_are_fitted_by_their_raw_columns(tmp_path: Path) -> None:
    made = made_ngsim.table(made_ngsim.Traffic(SITES["i80"], "1600", rows=20_000))
    made_ngsim.write_text(made, tmp_path / "made.txt")
    table, site = for_fitting(tmp_path / "made.txt")
    assert site == "i80"
    plan = fit_plan(table, Layout(int(table["lane"].max())))
    assert np.abs(plan.left_edge[5:-5, 1]).max() < 0.2  # frame map: y is 0 where local_x is
    np.testing.assert_allclose(plan.widths, 3.66, atol=0.1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "a.net.xml"], "name the recording to fit lanes to"),
        (["--recording", "a.parquet"], "name the net to write with --out"),
        (["--recording", "absent.parquet", "--out", "a.net.xml"], "no such recording"),
        (["--check", "absent.net.xml"], "no such net"),
    ],
)
def test_commands_that_cannot_be_done(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["map", *arguments])
    assert message in capsys.readouterr().err


# Published geometry


def test_layout_of_i80() -> None:
    lane_map = LaneMap.from_net(packaged("nets/i80.net.xml"))
    by_id = {lane.id: lane for lane in lane_map.lanes}
    assert len(by_id) == 6 + 7 + 6 + 1
    assert by_id["on_ramp_0"].successors == ("weave_0",)
    assert by_id["weave_0"].successors == ()  # lane 7 ends
    found = connectivity(lane_map)
    assert found.failures == [] and found.ending == ("weave_0",)
    assert lane_map.bounds[0] == pytest.approx(-120.0) and lane_map.bounds[2] == pytest.approx(623.0)
    at = lane_map.nearest(np.array([300.0, 150.0]), np.array([-1.0, -24.0]))
    assert lane_numbers(lane_map)[at.lane].tolist() == [1, 7]


# Checks


def two_lanes() -> LaneMap:
    return LaneMap([made_lane("a_0", (0, -5.25), (100, -5.25)), made_lane("a_1", (0, -1.75), (100, -1.75))])


def test_distance_to_cad_lines_by_their_numbers() -> None:
    lines = [CenterLine(f"centerline{n}", np.array([[-50.0, y], [150.0, y]])) for n, y in ((1, -1.65), (2, -5.05))]
    table = pd.DataFrame({"x": [30.0], "y": [-2.0]})
    found = cad_distance(two_lanes(), table, lines)
    assert found.by_line == {"centerline1": pytest.approx(0.1), "centerline2": pytest.approx(0.2)}
    swapped = [CenterLine(f"centerline{3 - n}", line.points) for n, line in enumerate(lines, 1)]
    assert cad_distance(two_lanes(), table, swapped).median > 3.0  # not simply the nearest line
    with pytest.raises(InputError, match="is it the right site"):
        cad_distance(two_lanes(), table, [CenterLine("centerline1", lines[0].points + 5000.0)])


def test_cad_files(tmp_path: Path) -> None:
    site = SITES["us101"]
    corners = np.array([[100.0, -1.0], [300.0, -1.0]])
    feet = np.column_stack(made_ngsim.global_from_map(site, *corners.T)) / FOOT
    text = "CENTERLINES\n1\nCENTERLINE\ncenterline1\n2\n" + "\n".join(f" {x:.6f}   {y:.6f}" for x, y in feet)
    (tmp_path / "cad.txt").write_text(text)
    lines, found = read_center_lines(tmp_path / "cad.txt")
    assert found is site and lines[0].name == "centerline1"
    np.testing.assert_allclose(lines[0].points, corners, atol=1e-3)
    for bad, message in (
        ("BOUNDARIES\n1", "does not begin with the line CENTERLINES"),
        (text.replace("\n2\n", "\n3\n"), "line 3: not a centre line: centerline1: expected 3 points"),
        ("CENTERLINES\n0\n", "no centre lines"),
        ("CENTERLINES\n1\nCENTERLINE\na\n2\n0 0\n1 1\n", "on none of the sites"),
    ):
        (tmp_path / "bad.txt").write_text(bad)
        with pytest.raises(InputError, match=message):
            read_center_lines(tmp_path / "bad.txt")


# Real data


@pytest.fixture(scope="module")
def data() -> Path:
    folder = os.environ.get("LITSIM_DATA")
    if not folder or not (Path(folder) / "ngsim").is_dir():
        pytest.skip("LITSIM_DATA names no folder of real data")
    return Path(folder)


@pytest.mark.data
def test_the_us101_net_meets_its_goals(data: Path) -> None:
    parts = for_checking(data / "ngsim" / "us101_0750_frames_0126_1149.parquet")
    lines, _ = read_center_lines(data / "maps" / "cad" / "centerlines101.txt")
    found = check_net(packaged("nets/us101.net.xml"), parts, lines)
    assert found.failures == []
    assert all(part.inside > 0.999 and part.inside_named > 0.989 for part in found.placements.values())
    assert found.placements["recording"].inside_named > 0.99
    assert found.cad is not None and found.cad.median < 0.26 and max(found.cad.by_line.values()) < 0.4


@pytest.mark.data
@pytest.mark.usefixtures("netconvert")
def test_the_packaged_us101_net_is_what_the_code_builds(data: Path, tmp_path: Path) -> None:
    source = data / "ngsim" / "us101_0750_frames_0126_1149.parquet"
    main(["map", "--recording", str(source), "--out", str(tmp_path / "us101.net.xml")])
    built, shipped = (LaneMap.from_net(p) for p in (tmp_path / "us101.net.xml", packaged("nets/us101.net.xml")))
    for one, other in zip(built.lanes, shipped.lanes, strict=True):
        np.testing.assert_allclose(one.centerline, other.centerline, atol=0.005)
