"""The map around agents, as the learned predictors see it."""

from __future__ import annotations

import numpy as np
import pytest

from litsim_predictor.inference.raster import AHEAD, COLUMNS, LEFT, ROWS, MapRaster, raster_of_net
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
