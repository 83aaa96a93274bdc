"""Turns, crossings, merges and left turns at a junction of the packaged street."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from litsim_data.mining.events import Event, EventKind, Situation
from litsim_data.mining.junction_events import encounters, turn_events
from litsim_data.mining.signals import WaySignals
from litsim_sim.core.scene import OBSTACLE_KINDS, STEP_S, Kind
from litsim_sim.core.signals import SignalState
from made_traffic import STREET, Vehicle, mirrored_lanes, mirrored_log, on_path, situation, times

EGO, OTHER = 1, 2
EAST, NORTHWARD = ("WA_0", "AB_0"), ("ASA_0", "AAN_0")  # straight on, from the west and from the south
LEFT, ONCOMING = ("WA_2", "AAN_0"), ("BA_1", "AW_1")
SPEED = 8.0


def met(*vehicles: Vehicle, signals: WaySignals | None = None) -> list[Event]:
    return list(encounters(situation(*vehicles, lane_map=STREET, signals=signals)))


def test_nobody_meets_a_pedestrian_or_cyclist_on_the_lanes() -> None:
    south, west = on_path(OTHER, NORTHWARD, 70.0, SPEED), on_path(EGO, EAST, 0.0, SPEED)
    later = west.y[0] - south.y[0] - (south.x[0] - west.x[0]) + 20.0  # 2.5 s after the one from the south
    west = on_path(EGO, EAST, -later, SPEED)
    for kind in (Kind.CAR, *OBSTACLE_KINDS):
        assert bool(met(replace(west, kind=int(kind)), south)) == (kind == Kind.CAR)


@settings(max_examples=25)
@given(later=st.floats(0.5, 3.5))
def test_the_pet_of_a_crossing_is_from_leaving_to_entering(later: float) -> None:
    """Both drive straight at 8 m/s; when the one from the south is gone, the one from the west comes."""
    south, west = on_path(OTHER, NORTHWARD, 70.0, SPEED), on_path(EGO, EAST, 0.0, SPEED)
    meet_x, meet_y = south.x[0], west.y[0]
    gone = (meet_y + 1.0 + 0.5 * 4.5 - south.y[0]) / SPEED  # its rear leaves the other's strip of 2 m
    begin = meet_x - 1.0 - 0.5 * 4.5 - SPEED * (gone + later) - west.x[0]  # for a front that comes `later`
    events = met(on_path(EGO, EAST, begin, SPEED), south)
    assert [(event.kind, event.ego, event.other) for event in events] == [
        (EventKind.CROSSING, EGO, OTHER),
        (EventKind.CROSSING, OTHER, EGO),
    ]
    own, others = (event.numbers for event in events)
    assert own["pet_s"] == others["pet_s"] == pytest.approx(later, abs=2.1 * STEP_S)
    assert (own["first"], others["first"]) == ("other", "ego")
    assert own["angle_rad"] == pytest.approx(0.5 * np.pi, abs=0.15)  # one shifts over by a lane's half
    assert events[0].severity == pytest.approx(1.5 / (1.5 + float(str(own["pet_s"]))), abs=0.01)


def test_who_has_left_the_road_has_no_speed() -> None:
    """The log of the one from the south ends when it has crossed, before the other comes."""
    south, west = on_path(OTHER, NORTHWARD, 70.0, SPEED), on_path(EGO, EAST, 0.0, SPEED)
    gone = (west.y[0] + 1.0 + 0.5 * 4.5 - south.y[0]) / SPEED
    west = on_path(EGO, EAST, south.x[0] - 3.25 - SPEED * (gone + 4.5) - west.x[0], SPEED)
    (whole, _) = met(west, south)
    assert whole.numbers["other_speed_mps"] == pytest.approx(SPEED, abs=0.1)
    seen = round((gone + 4.0) / STEP_S)
    own, others = met(west, replace(south, x=south.x[:seen], y=south.y[:seen]))
    assert (own.numbers["pet_s"], own.step) == (whole.numbers["pet_s"], whole.step)
    assert own.numbers["speed_mps"] == others.numbers["other_speed_mps"] == pytest.approx(SPEED, abs=0.1)
    assert own.numbers["other_speed_mps"] is others.numbers["speed_mps"] is None


def test_whoever_comes_six_seconds_later_meets_nobody() -> None:
    assert len(met(on_path(EGO, EAST, 80.0, SPEED), on_path(OTHER, NORTHWARD, 85.0, SPEED))) == 2
    assert met(on_path(EGO, EAST, 40.0, SPEED), on_path(OTHER, NORTHWARD, 100.0, SPEED)) == []


def test_a_left_turn_across_oncoming_traffic() -> None:
    oncoming = on_path(OTHER, ONCOMING, 130.0, SPEED)
    turning, straight = met(on_path(EGO, LEFT, 80.0, SPEED), oncoming)
    assert (turning.kind, straight.kind) == (EventKind.LEFT_TURN, EventKind.LEFT_TURN)
    assert (turning.numbers["role"], straight.numbers["role"]) == ("turning", "oncoming")
    assert (turning.numbers["way"], turning.numbers["other_way"]) == ("left", "straight")
    assert turning.numbers["signal"] == "none"
    # Half a second later at the turn is half a second more.
    (later, _) = met(on_path(EGO, LEFT, 80.0 - 0.5 * SPEED, SPEED), oncoming)
    earlier, after = float(str(turning.numbers["pet_s"])), float(str(later.numbers["pet_s"]))
    assert after == pytest.approx(earlier + 0.5, abs=1.1 * STEP_S)
    assert later.severity < turning.severity


def test_where_traffic_keeps_left_it_is_right_turns_that_cross_oncoming_traffic() -> None:
    there = situation(on_path(EGO, LEFT, 80.0, SPEED), on_path(OTHER, ONCOMING, 130.0, SPEED), lane_map=STREET)
    mirrored = list(encounters(Situation.of(mirrored_log(there.log), mirrored_lanes(STREET))))
    assert {event.kind for event in mirrored} == {EventKind.RIGHT_TURN}
    assert [(each.numbers["role"], each.numbers["way"]) for each in mirrored] == [
        ("turning", "right"),
        ("oncoming", "straight"),
    ]
    assert [each.severity for each in mirrored] == [each.severity for each in encounters(there)]


def test_a_left_turn_far_behind_oncoming_traffic_is_only_a_crossing() -> None:
    events = met(on_path(EGO, LEFT, 50.0, SPEED), on_path(OTHER, ONCOMING, 130.0, SPEED))
    assert {event.kind for event in events} == {EventKind.CROSSING}
    assert 3.0 < float(str(events[0].numbers["pet_s"])) <= 5.0


TOGETHER, ALONE = ({LEFT: (f"g{own}",), ONCOMING: ("Gr",)} for own in ("r", "G"))  # letters by phase


def shown(oncoming: SignalState) -> WaySignals:
    states = {LEFT: SignalState.GREEN_PERMISSIVE, ONCOMING: oncoming}
    return WaySignals(ALONE, {way: np.full(300, state, np.uint8) for way, state in states.items()})


@pytest.mark.parametrize(
    ("signals", "kind"),
    [
        pytest.param(WaySignals(TOGETHER), EventKind.LEFT_TURN, id="has green only together with them"),
        pytest.param(WaySignals(ALONE), EventKind.CROSSING, id="has a phase alone"),
        pytest.param(shown(SignalState.GREEN), EventKind.LEFT_TURN, id="had green with them"),
        pytest.param(shown(SignalState.RED), EventKind.CROSSING, id="had green alone"),
        pytest.param(shown(SignalState.UNAVAILABLE), EventKind.CROSSING, id="not known then, has a phase alone"),
    ],
)
def test_a_left_turn_is_unprotected_if_its_light_does_not_let_it_go_alone(signals: WaySignals, kind: EventKind) -> None:
    events = met(on_path(EGO, LEFT, 80.0, SPEED), on_path(OTHER, ONCOMING, 130.0, SPEED), signals=signals)
    assert {event.kind for event in events} == {kind}


def test_ways_that_end_in_one_lane_merge() -> None:
    events = met(on_path(EGO, ("ANA_0", "AW_0"), 95.0, SPEED), on_path(OTHER, ("BA_0", "AW_0"), 120.0, SPEED))
    assert [(event.kind, event.ego) for event in events] == [(EventKind.MERGE, EGO), (EventKind.MERGE, OTHER)]


@pytest.mark.parametrize(
    "ways",
    [
        pytest.param((EAST, EAST), id="one behind the other"),
        pytest.param((EAST, ("BA_0", "AW_0")), id="opposite carriageways"),
        pytest.param((("WA_0", "AAS_0"), ("WA_1", "AB_1")), id="from one road"),
    ],
)
def test_ways_that_do_not_meet(ways: tuple[tuple[str, str], tuple[str, str]]) -> None:
    assert met(on_path(EGO, ways[0], 90.0, SPEED), on_path(OTHER, ways[1], 100.0, SPEED)) == []


def arc(radius: float, speed: float, angle: float) -> Vehicle:
    """Turns left on a circle from the fourth second on."""
    t = times()
    turned = np.clip(speed * (t - 4.0) / radius, 0.0, angle)
    way = np.stack([np.cos(turned), np.sin(turned)]) * speed * STEP_S
    return Vehicle(EGO, 100.0 + np.cumsum(way[0]), np.cumsum(way[1]))


def test_a_turn_has_its_angle_and_lateral_acceleration() -> None:
    (event,) = turn_events(situation(arc(15.0, 5.0, 0.5 * np.pi)))
    assert event.numbers["angle_rad"] == pytest.approx(0.5 * np.pi, abs=0.1)
    assert event.numbers["lateral_acceleration_mps2"] == pytest.approx(25.0 / 15.0, abs=0.1)
    assert event.numbers["to"] == "left"
    assert event.begin * STEP_S == pytest.approx(4.0, abs=0.6)


@pytest.mark.parametrize(
    "vehicle",
    [
        pytest.param(arc(15.0, 5.0, np.deg2rad(40.0)), id="40 degrees"),
        pytest.param(arc(150.0, 10.0, np.deg2rad(90.0)), id="3.8 degrees a second"),
    ],
)
def test_what_is_no_turn(vehicle: Vehicle) -> None:
    assert list(turn_events(situation(vehicle))) == []
