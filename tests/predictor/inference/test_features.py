"""The frames of agents, in which the learned predictors see and answer."""

import numpy as np
import pytest

from litsim_predictor.inference.features import frame_headings
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import Scenario

NET = Scenario.load("demo").net_path


def test_agents_that_drive_along_a_lane_have_its_heading_others_their_own() -> None:
    lane_map = LaneMap.from_net(NET)
    x, y = np.full(3, 200.0), np.array([-5.0, -5.0, 400.0])
    heading = frame_headings(lane_map, x, y, np.array([0.1, 1.5, 0.1]))
    assert heading == pytest.approx([0.0, 1.5, 0.1], abs=1e-3)
    assert frame_headings(None, x, y, np.array([0.1, 1.5, 0.1])) == pytest.approx([0.1, 1.5, 0.1])
