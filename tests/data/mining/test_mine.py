"""What is searched of a scenario: its possible egos, while it runs."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from litsim_data.mining.events import EventKind
from litsim_data.mining.mine import mine, possible_egos
from litsim_data.mining.signals import signal_plans
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.scenario import Scenario, packaged
from made_traffic import Vehicle, changing, straight

STREET = packaged("nets/urban_like.net.xml")
CHANGE = [(0.0, 2.0), (3.0, 2.0), (6.0, 1.0), (12.0, 1.0)]  # crosses at 4.5 s


@pytest.fixture
def made(make_scenario: Callable[..., Scenario]) -> Callable[..., Scenario]:
    def make(*vehicles: Vehicle, **fields: Any) -> Scenario:
        return make_scenario(*vehicles, **({"history_s": 3.0} | fields))

    return make


def test_events_are_those_of_possible_egos_while_the_scenario_runs(made: Callable[..., Scenario]) -> None:
    vehicles = straight(1, 0.0, 20.0, 1), changing(2, 40.0, 15.0, CHANGE)
    kinds = [EventKind.CUT_IN, EventKind.LANE_CHANGE]
    assert [(each.kind, each.ego) for each in mine(made(*vehicles), kinds)] == [
        (EventKind.CUT_IN, 1),
        (EventKind.LANE_CHANGE, 2),
    ]
    assert mine(made(*vehicles), [EventKind.MERGE]) == []
    assert mine(made(*vehicles, history_s=6.0), kinds) == []  # it was before the ego is free
    assert mine(made(*vehicles, simulation_s=1.0), kinds) == []  # it would be after the end


def test_motorcycles_and_latecomers_are_no_egos(made: Callable[..., Scenario]) -> None:
    late = straight(3, 0.0, 20.0, 3)
    scenario = made(
        straight(1, 0.0, 20.0, 1),
        Vehicle(2, late.x, late.y - 3.66, kind=int(Kind.MOTORCYCLE)),
        Vehicle(3, late.x, late.y, first=5),
    )
    assert list(possible_egos(scenario)) == [1]


def test_streets_of_generated_traffic_have_what_streets_have() -> None:
    scenarios = [Scenario.load(path) for path in sorted(packaged("suites/small", "litsim_eval").glob("street_*.yaml"))]
    assert all(scenario.signals is not None for scenario in scenarios)
    found = [event for scenario in scenarios for event in mine(scenario)]
    assert {event.kind for event in found} >= {EventKind.TURN, EventKind.LEFT_TURN, EventKind.CROSSING}
    assert {event.numbers["signal"] for event in found if event.kind == EventKind.LEFT_TURN} == {"permissive"}


def test_the_plans_of_a_net_are_by_lanes(tmp_path: Path) -> None:
    plans = signal_plans(STREET)
    assert len(plans) == 2 * 14  # ways through two junctions
    assert {tuple(map(len, programs)) for programs in plans.values()} == {(6,)}  # phases of the only program
    assert set("".join(plans["WA_2", "AAN_0"])) <= set("Ggyr")
    assert signal_plans(packaged("nets/us101_like.net.xml")) == {}
    net = tmp_path / "imported.net.xml"  # with the names of the map that it was made from, as of OpenDRIVE
    named = re.sub(r'(<lane id=":[^>]*)/>', r'\1><param key="origId" value="7_-1"/></lane>', text := STREET.read_text())
    net.write_text(named)
    assert named != text and signal_plans(net) == plans
