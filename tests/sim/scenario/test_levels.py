"""Roads that cross at different heights: vehicles on one do not touch those on the other, nor yield to them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import Scenario

NET = """<net version="1.20">
    <location netOffset="0,0" convBoundary="-200,-200,200,200" origBoundary="-200,-200,200,200" projParameter="!"/>
    <edge id="low" from="w" to="e" priority="1">
        <lane id="low_0" index="0" speed="14" length="400" shape="-200,0 200,0"/>
    </edge>
    <edge id="high" from="s" to="m" priority="1">
        <lane id="high_0" index="0" speed="14" length="240" shape="0,-200,{ramp} 0,40,{high}"/>
    </edge>
    <edge id="down" from="m" to="n" priority="1">
        <lane id="down_0" index="0" speed="14" length="60" shape="0,40,{high} 60,40,{high}"/>
        <lane id="down_1" index="1" speed="14" length="60" shape="0,43,{high} 60,43,{high}"/>
    </edge>
    <edge id="far" from="fw" to="fe" priority="1">
        <lane id="far_0" index="0" speed="14" length="400" shape="-200,150 200,150"/>
    </edge>
    <junction id="w" type="dead_end" x="-200" y="0" incLanes="" intLanes="" shape="-200,0 -200,-3"/>
    <junction id="e" type="dead_end" x="200" y="0" incLanes="low_0" intLanes="" shape="200,-3 200,0"/>
    <junction id="s" type="dead_end" x="0" y="-200" incLanes="" intLanes="" shape="0,-200 3,-200"/>
    <junction id="m" type="priority" x="0" y="40" incLanes="high_0" intLanes="" shape="3,40 0,40"/>
    <junction id="n" type="dead_end" x="60" y="40" incLanes="down_0 down_1" intLanes="" shape="60,43 60,40"/>
    <junction id="fw" type="dead_end" x="-200" y="150" incLanes="" intLanes="" shape="-200,150 -200,147"/>
    <junction id="fe" type="dead_end" x="200" y="150" incLanes="far_0" intLanes="" shape="200,147 200,150"/>
    <connection from="high" to="down" fromLane="0" toLane="0" dir="r" state="M"/>
</net>
"""
EGO, OVER, FAR = 1, 2, 3


def bridge(folder: Path, high: float, ramp: float | None = None) -> Path:
    """A net in which one road crosses another at height `high` [m], from height `ramp` on, and a third is elsewhere."""
    path = folder / "bridge.net.xml"
    path.write_text(NET.format(high=high, ramp=high if ramp is None else ramp))
    return path


@pytest.fixture
def scenario(tmp_path: Path, make_scenario: Callable[..., Scenario], track: Any) -> Callable[..., Scenario]:
    """Two vehicles that reach the crossing together, and one elsewhere; the ego is the one below."""

    def make(high: float, name: str = "bridge") -> Scenario:
        below = track(EGO, -60.0, 0.0, last=90)
        above = track(OVER, 0.0, -60.0, yaw=0.5 * np.pi, last=90)
        far, net = track(FAR, -60.0, 150.0, last=90), str(bridge(tmp_path, high))
        return make_scenario(below, above, far, net=net, name=name)

    return make


@pytest.mark.parametrize(("high", "touching"), [(0.5, True), (7.0, False)])
def test_vehicles_touch_and_yield_only_at_one_height(
    scenario: Callable[..., Scenario], drive: Callable[..., Any], high: float, touching: bool
) -> None:
    made = scenario(high)
    assert made.log.ids.tolist() == ([EGO, OVER, FAR] if touching else [EGO, FAR])
    replayed = drive(made, "log", "replay")
    assert bool(replayed.world.contacts) == touching
    driven = drive(made, "idm", "litsim")
    assert any(result.takeovers.takeovers for result in driven.results) == touching


def test_a_scenario_has_the_level_of_its_ego(
    scenario: Callable[..., Scenario], caplog: pytest.LogCaptureFixture
) -> None:
    below = scenario(7.0, name="told")  # once for each name
    assert np.unique(below.recording.columns["vehicle_id"]).tolist() == [EGO, FAR]
    assert "told: agents on roads above or below that of ego 1 are left out: 1" in caplog.text
    above = below.around(OVER, None)
    assert above.log.ids.tolist() == [OVER, FAR] and above.last_logged.tolist() == [90]
    assert above.around(EGO, None).log.ids.tolist() == below.log.ids.tolist() == [EGO, FAR]


@pytest.mark.parametrize(("high", "ramp", "levels"), [(7.0, 7.0, 2), (7.0, 1.0, 2), (3.2, 2.0, 1), (2.5, 2.5, 1)])
def test_levels_of_a_net(tmp_path: Path, high: float, ramp: float, levels: int) -> None:
    lane_map = LaneMap.from_net(bridge(tmp_path, high, ramp))
    if lane_map.levels is None:
        assert (high, levels) == (2.5, 1), "too flat"
        return
    part = {lane.edge_id: part for lane, part in zip(lane_map.lanes, lane_map.levels.part.tolist(), strict=True)}
    assert part["high"] == part["down"] != part["far"], "lanes side by side, and one after the other, are of one part"
    assert len({part["low"], part["high"]}) == levels
    apart = lane_map.levels.apart_from(part["low"])
    assert [bool(apart[part[name]]) for name in ("low", "high", "far")] == [False, levels == 2, False]
