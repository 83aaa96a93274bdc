"""The traffic that benchmarks run on."""

from __future__ import annotations

from litsim_eval.benchmark.steps import columns_of_traffic
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import STEP_S
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

AGENTS, STEPS = 250, 140  # more agents do not fit on the net of the demo


def test_the_traffic_is_on_the_road_and_nobody_overlaps() -> None:
    lane_map = Scenario.load("demo").lane_map
    log = Log.from_recording(columns_of_traffic(AGENTS, STEPS * STEP_S, first_id=7), 0, STEPS + 1)
    for step in (0, STEPS):
        table = log.table(step)
        assert (len(table), table.row(7)) == (AGENTS, 0)
        assert lane_map.inside_road(table.x, table.y).all()
        assert not len(overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width))
