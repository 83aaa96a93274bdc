"""The map around agents, as the learned predictors see it."""

from pathlib import Path

import numpy as np
import pytest

from litsim_predictor.inference.raster import AHEAD, COLUMNS, LEFT, ROWS, MapRaster, raster_of_net
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import Scenario

NET = Scenario.load("demo").net_path
DRIVABLE, CLOSENESS, COSINE, SINE = range(4)


def test_the_map_ahead_is_the_lanes_that_the_net_has_there() -> None:
    lane_map, raster = raster_of_net(NET)
    x, y, heading = np.array([200.0]), np.array([-3.66 * 1.5]), np.array([0.0])
    cut = raster.cut(x, y, heading)[0]
    assert cut.shape == (4, ROWS, COLUMNS)
    ahead, left = np.meshgrid(x[0] + AHEAD, y[0] + LEFT, indexing="ij")
    drivable = lane_map.inside_road(ahead.ravel(), left.ravel()).reshape(ROWS, COLUMNS)
    # A cell of the drawing is half a metre: at the edge of the road they may differ.
    assert (cut[DRIVABLE] == 255).mean() == pytest.approx(drivable.mean(), abs=0.05)
    assert drivable.any() and not drivable.all()
    assert (cut[COSINE][drivable & (cut[DRIVABLE] > 0)] >= 254).all()
    on_centre = np.argmin(np.abs(LEFT))
    assert cut[CLOSENESS][5, on_centre] > 100


@pytest.mark.parametrize("turn", [0.5, -1.0, 3.0])
def test_directions_are_relative_to_the_agent(turn: float) -> None:
    _, raster = raster_of_net(NET)
    cut = raster.cut(np.array([200.0]), np.array([-5.5]), np.array([turn]))[0].astype(float)
    road = cut[DRIVABLE] > 0
    assert (cut[COSINE][road] - 128) / 127 == pytest.approx(np.cos(turn), abs=0.03)
    assert (cut[SINE][road] - 128) / 127 == pytest.approx(-np.sin(turn), abs=0.03)


@pytest.mark.parametrize("far", [1e3, -1e3, 1e7])
def test_off_the_net_there_is_no_road(far: float) -> None:
    _, raster = raster_of_net(NET)
    cut = raster.cut(np.array([far]), np.array([far]), np.array([0.3]))
    assert not cut[:, DRIVABLE].any() and (cut[:, COSINE] == 128).all()


def test_without_a_net_there_is_no_road() -> None:
    assert not MapRaster(None).cut(np.zeros(2), np.zeros(2), np.zeros(2))[:, :2].any()


def net_of_a_road(path: Path, x: float, y: float) -> Path:
    """A net of one straight road from the origin to a place [m]."""
    length = np.hypot(x, y)
    lane = f'<lane id="e_0" index="0" speed="30" length="{length}" width="3.5" shape="0,0 {x},{y}"/>'
    ends = "".join(
        f'<junction id="{name}" type="dead_end" x="{at[0]}" y="{at[1]}" incLanes="{lanes}" intLanes="" shape="0,0"/>'
        for name, at, lanes in (("a", (0.0, 0.0), ""), ("b", (x, y), "e_0"))
    )
    path.write_text(
        f'<net version="1.20"><location netOffset="0,0" convBoundary="0,0,{x},{y}" origBoundary="0,0,{x},{y}" '
        f'projParameter="!"/><edge id="e" from="a" to="b" priority="1">{lane}</edge>{ends}</net>'
    )
    return path


def test_a_large_net_is_drawn_as_finely_as_a_small_one(tmp_path: Path) -> None:
    path = net_of_a_road(tmp_path / "long.net.xml", 10_000.0, 3_000.0)
    lane_map, raster = raster_of_net(path)
    turn = np.arctan2(3_000.0, 10_000.0)
    along = np.array([9_000.0])
    cut = raster.cut(along * np.cos(turn), along * np.sin(turn), np.array([turn]))[0]
    ahead = along[0] * np.cos(turn) + np.cos(turn) * AHEAD[:, None] - np.sin(turn) * LEFT
    left = along[0] * np.sin(turn) + np.sin(turn) * AHEAD[:, None] + np.cos(turn) * LEFT
    drivable = lane_map.inside_road(ahead.ravel(), left.ravel()).reshape(ROWS, COLUMNS)
    assert 0.1 < drivable.mean() < 0.3
    assert ((cut[DRIVABLE] == 255) != drivable).mean() < 0.01


def test_a_net_that_is_too_large_to_be_drawn_is_refused(tmp_path: Path) -> None:
    path = net_of_a_road(tmp_path / "far.net.xml", 20_000.0, 6_000.0)
    with pytest.raises(
        InputError, match=r"far.net.xml: the net covers 20.0 km by 6.0 km, expected at most 100 km2 for a"
    ):
        raster_of_net(path)
