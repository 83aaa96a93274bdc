"""Nets of one carriageway, fitted under lane labels, and what the check says of packaged motorways."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from command_line import refusal
from litsim_data.cli import main
from litsim_data.maps.carriageway import MARGIN, fit_carriageway
from litsim_data.maps.check import check_net
from litsim_data.maps.connectivity import connectivity
from litsim_data.maps.placement import lane_numbers
from litsim_data.maps.positions import positions_of
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.recording import COLUMNS, Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged

WIDTHS = np.array([3.7, 3.5, 3.4, 3.6, 3.6])
CENTRES = np.cumsum(WIDTHS) - 0.5 * WIDTHS


def bend(x: np.ndarray) -> np.ndarray:
    """y of the left edge of a made road."""
    return 3.0 - 1e-4 * (x - 300.0) ** 2


def positions(seed: int, n: int = 8000) -> pd.DataFrame:
    """Vehicles on a made road of five lanes that bends; some have left it by a ramp, in lane 6."""
    rng = np.random.default_rng(seed)
    lane, x = rng.integers(1, 6, n), rng.uniform(0.0, 600.0, n)
    right = CENTRES[lane - 1] + rng.normal(0.0, 0.3, n)
    lane[:50], right[:50] = 6, 30.0
    y = bend(x) - right * np.sqrt(1 + (2e-4 * (x - 300)) ** 2)
    return pd.DataFrame({"x": x, "y": y, "yaw": np.arctan(-2e-4 * (x - 300)), "lane": lane})


@pytest.mark.parametrize("heading", [0.0, 2.0, -1.5])
def test_a_carriageway_in_any_direction(heading: float) -> None:
    table = positions(3)
    cos, sin = np.cos(heading), np.sin(heading)
    turned = table.assign(
        x=cos * table["x"] - sin * table["y"], y=sin * table["x"] + cos * table["y"], yaw=table["yaw"] + heading
    )
    graph = fit_carriageway(turned)
    assert [lane.left_id for lane in graph.lanelets] == [None, "lane_1", "lane_2", "lane_3", "lane_4"]
    np.testing.assert_allclose([lane.width for lane in graph.lanelets], WIDTHS, atol=0.1)
    back = graph.lanelets[0].left @ np.array([[cos, -sin], [sin, cos]])
    assert np.abs([back[0, 0] + MARGIN, back[-1, 0] - 600.0 - MARGIN]).max() < 12.0
    inner = back[(back[:, 0] > 0) & (back[:, 0] < 590)]
    assert np.abs(inner[:, 1] - bend(inner[:, 0])).mean() < 0.2


def test_one_lane_has_the_usual_width() -> None:
    table = positions(3)
    (lane,) = fit_carriageway(table[table["lane"] == 1]).lanelets
    assert lane.width == pytest.approx(3.66, abs=0.01)


def test_recordings_that_do_not_allow_a_fit() -> None:
    table = positions(4)
    with pytest.raises(InputError, match="has no lane numbers"):
        fit_carriageway(table.assign(lane=-1))
    with pytest.raises(InputError, match="expected 100 in lane 1"):
        fit_carriageway(table.iloc[:60])
    with pytest.raises(InputError, match="headings differ by more than 60 degrees"):
        fit_carriageway(table.assign(yaw=np.where(np.arange(len(table)) % 2, 0.0, np.pi)))


@pytest.mark.usefixtures("netconvert")
def test_a_recording_through_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = positions(5, n=4000)
    made = made[made["lane"] <= 5].reset_index(drop=True)
    table = made.assign(vehicle_id=np.arange(len(made)), frame=0, speed=10.0, acceleration=0.0, length=4.5, width=1.8)
    Recording.from_table(RecordingHeader("made"), table.assign(kind=0)[list(COLUMNS)], "made").write(
        tmp_path / "r.parquet"
    )
    net = str(tmp_path / "r.net.xml")
    main(["map", "--recording", str(tmp_path / "r.parquet"), "--out", net])
    main(["map", "--check", net, "--recording", str(tmp_path / "r.parquet")])
    assert "SUMO: loads without warnings" in capsys.readouterr().out
    lane_map = LaneMap.from_net(Path(net))
    assert lane_numbers(lane_map).tolist() == [5, 4, 3, 2, 1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "a.net.xml"], "name the recording to fit lanes to"),
        (["--recording", "a.parquet"], "name the net to write with --out"),
        (["--recording", "absent.parquet", "--out", "a.net.xml"], "no such recording"),
        (["--check", "absent.net.xml"], "no such net"),
        (["--check", "us101", "--recording", "a.parquet", "--scenario", "demo"], "--scenario goes without --recording"),
    ],
)
def test_commands_that_cannot_be_done(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert message in refusal(capsys, main, "map", *arguments)


def test_layout_of_i80() -> None:
    lane_map = LaneMap.from_net(packaged("nets/i80.net.xml"))
    by_id = {lane.id: lane for lane in lane_map.lanes}
    assert len(by_id) == 6 + 7 + 6 + 1
    assert by_id["on_ramp_0"].successors == ("weave_0",)
    assert by_id["weave_0"].successors == ()  # lane 7 ends
    lanes = connectivity(lane_map)
    assert lanes.failures == [] and lanes.ending == ("weave_0",)
    at = lane_map.nearest(np.array([300.0, 150.0]), np.array([-1.0, -24.0]))
    assert lane_numbers(lane_map)[at.lane].tolist() == [1, 7]


@pytest.mark.data
def test_the_us101_net_meets_its_goals(real_data) -> None:
    check = check_net(packaged("nets/us101.net.xml"), {"recording": positions_of(real_data())})
    assert check.failures == []
    assert check.placements["recording"].inside > 0.999 and check.placements["recording"].inside_named > 0.99
