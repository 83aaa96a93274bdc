"""Cut-ins, cut-outs, lane changes of the ego, merges: known numbers, and what is none."""

from collections.abc import Callable, Iterator

import pytest

from litsim_data.mining.events import Event, EventKind, Situation
from litsim_data.mining.lane_events import cut_ins, cut_outs, lane_change_events, lane_merges
from litsim_data.mining.mine import events_in
from litsim_sim.core.scene import STEP_S
from litsim_sim.scenario.scenario import Scenario
from made_traffic import STREET, Vehicle, changing, mirrored_lanes, mirrored_log, on_path, situation, straight

EGO, OTHER, THIRD = 1, 2, 3
LENGTH = 4.5
INTO_LANE_1 = [(0.0, 2.0), (3.0, 2.0), (6.0, 1.0), (12.0, 1.0)]  # over the border at 4.5 s


def of_ego(finder: Callable[[Situation], Iterator[Event]], *vehicles: Vehicle) -> list[Event]:
    return [event for event in finder(situation(*vehicles)) if event.ego == EGO]


def gap_at(event: Event, distance: float, closing: float) -> float:
    return distance - LENGTH - closing * event.step * STEP_S


def test_a_cut_in_has_the_gap_and_the_ttc_of_the_moment_it_crosses() -> None:
    ego, other = straight(EGO, 0.0, 20.0, 1), changing(OTHER, 40.0, 15.0, INTO_LANE_1)
    (event,) = of_ego(cut_ins, ego, other)
    gap = gap_at(event, 40.0, 5.0)
    assert (event.kind, event.other) == (EventKind.CUT_IN, OTHER)
    assert event.step * STEP_S == pytest.approx(4.5, abs=1.1 * STEP_S)
    assert event.numbers["gap_m"] == pytest.approx(gap, abs=0.01)
    assert event.numbers["closing_mps"] == pytest.approx(5.0, abs=0.01)
    assert event.numbers["ttc_s"] == pytest.approx(gap / 5.0, abs=0.01)
    assert event.numbers["headway_s"] == pytest.approx(gap / 20.0, abs=0.01)
    assert event.numbers["from"] == "right"
    assert event.numbers["r157"] == "to be avoided"  # 5 / 12 + 0.35 s is less
    assert event.numbers["ttc_min_s"] == 0.0  # the ego drives on as it did, into it
    assert event.severity == 1.0


def test_a_cut_in_that_nobody_can_avoid_is_one_below_the_time_of_r157() -> None:
    ego, other = straight(EGO, 0.0, 25.0, 1), changing(OTHER, 53.5, 15.0, INTO_LANE_1)
    (event,) = of_ego(cut_ins, ego, other)
    ttc = gap_at(event, 53.5, 10.0) / 10.0
    assert 0.0 < ttc < 10.0 / 12.0 + 0.35
    assert event.numbers["ttc_s"] == pytest.approx(ttc, abs=0.02)
    assert event.numbers["r157"] == "unavoidable"


def test_a_cut_in_that_opens_has_no_ttc() -> None:
    ego, other = straight(EGO, 0.0, 10.0, 1), changing(OTHER, 15.0, 12.0, INTO_LANE_1)
    (event,) = of_ego(cut_ins, ego, other)
    assert event.numbers["ttc_s"] is None
    assert event.numbers["ttc_min_s"] is None
    assert "r157" not in event.numbers
    headway = gap_at(event, 15.0, -2.0) / 10.0
    assert event.severity == pytest.approx(0.9 / (0.9 + headway), abs=0.01)


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(straight(OTHER, 40.0, 15.0, 1), id="was the leader before"),
        pytest.param(changing(OTHER, 40.0, 15.0, [(0, 2), (3, 2), (4, 1.4), (5, 2), (12, 2)]), id="comes back"),
        pytest.param(changing(OTHER, 40.0, 15.0, [(0, 3), (3, 3), (6, 2), (12, 2)]), id="stays a lane away"),
        pytest.param(changing(OTHER, 40.0, 15.0, [(0, 3), (1.5, 3), (3, 2), (6, 1), (12, 1)]), id="changes twice"),
        pytest.param(changing(OTHER, -40.0, 15.0, INTO_LANE_1), id="goes behind"),
        pytest.param(changing(OTHER, 120.0, 18.0, INTO_LANE_1), id="is more than 3.5 s ahead"),
    ],
)
def test_what_is_no_cut_in(other: Vehicle) -> None:
    assert of_ego(cut_ins, straight(EGO, 0.0, 20.0, 1), other) == []


def test_an_ego_that_changes_lanes_itself_is_not_cut_in_on() -> None:
    ego, other = changing(EGO, 0.0, 16.0, INTO_LANE_1), straight(OTHER, 30.0, 15.0, 1)
    assert of_ego(cut_ins, ego, other) == []
    # ... nor if both go for the lane between them.
    both = changing(OTHER, 30.0, 15.0, [(0.0, 0.0), (3.0, 0.0), (6.0, 1.0), (12.0, 1.0)])
    assert of_ego(cut_ins, ego, both) == []


def test_an_oncoming_vehicle_is_no_cut_in() -> None:
    ego, other = on_path(EGO, ("WA_2", "AAN_0"), 20.0, 8.0), on_path(OTHER, ("BA_1", "AW_1"), 150.0, 8.0)
    assert events_in(situation(ego, other, lane_map=STREET), [EventKind.CUT_IN, EventKind.LANE_CHANGE]) == []


def test_a_cut_out_shows_who_was_ahead_of_the_leader() -> None:
    out = [(0.0, 1.0), (3.0, 1.0), (6.0, 2.0), (12.0, 2.0)]
    ego, leader, slow = straight(EGO, 0.0, 20.0, 1), changing(OTHER, 25.0, 20.0, out), straight(THIRD, 100.0, 8.0, 1)
    (event,) = of_ego(cut_outs, ego, leader, slow)
    assert (event.other, event.numbers["leader_id"]) == (THIRD, OTHER)
    assert event.numbers["gap_m"] == pytest.approx(gap_at(event, 100.0, 12.0), abs=0.01)
    # The leader's own time to it was least in its last step behind it.
    last = (75.0 - LENGTH - 12.0 * (event.step - 1) * STEP_S) / 12.0
    assert event.numbers["leader_ttc_min_s"] == pytest.approx(last, abs=0.05)
    assert of_ego(cut_outs, ego, leader) == []  # nothing is shown


def test_a_lane_change_of_the_ego_has_what_is_ahead_and_behind_in_the_new_lane() -> None:
    ego, ahead = changing(EGO, 40.0, 15.0, INTO_LANE_1), straight(OTHER, 70.0, 14.0, 1)
    behind, beside = straight(THIRD, 0.0, 18.0, 1), straight(4, 60.0, 15.0, 2)
    (event,) = of_ego(lane_change_events, ego, ahead, behind, beside)
    after, before = gap_at(event, 40.0, 3.0), gap_at(event, 30.0, 1.0)
    assert event.numbers["ahead_gap_m"] == pytest.approx(before, abs=0.01)
    assert event.numbers["ahead_ttc_s"] == pytest.approx(before / 1.0, rel=0.01)
    assert event.numbers["behind_gap_m"] == pytest.approx(after, abs=0.01)
    assert event.numbers["behind_ttc_s"] == pytest.approx(after / 3.0, rel=0.01)
    assert event.numbers["to"] == "left"
    assert event.other == THIRD  # 7.3 s to the one behind, 21 s to the one ahead; headways are 1.2 and 1.4 s
    assert event.numbers["duration_s"] == pytest.approx(3.0 * (3.66 - 0.75) / 3.66, abs=2 * STEP_S)


def test_a_lane_change_on_an_empty_road_has_no_numbers_of_others() -> None:
    (event,) = of_ego(lane_change_events, changing(EGO, 40.0, 15.0, INTO_LANE_1))
    assert event.other is None
    assert event.severity == 0.0
    names = ("gap_m", "closing_mps", "headway_s", "ttc_s")
    assert [event.numbers[f"{side}_{name}"] for side in ("ahead", "behind") for name in names] == [None] * 8


def test_a_merge_comes_from_the_lane_of_the_ramp() -> None:
    from_ramp = [(0.0, 5.0), (3.0, 5.0), (6.0, 4.0), (12.0, 4.0)]  # lane 5 is the auxiliary lane, from 176 m on
    merging, yielding = changing(EGO, 185.0, 14.0, from_ramp), straight(OTHER, 160.0, 15.0, 4)
    events = list(lane_merges(situation(merging, yielding)))
    assert [(event.ego, event.other, event.numbers["role"]) for event in events] == [
        (EGO, OTHER, "merging"),
        (OTHER, EGO, "merged ahead of"),
    ]
    gap = gap_at(events[0], 25.0, 1.0)
    assert events[0].numbers["behind_gap_m"] == pytest.approx(gap, abs=0.01)
    assert events[1].numbers["gap_m"] == pytest.approx(gap, abs=0.01)
    # A change between lanes of the motorway is none, nor is one to the exit.
    for lanes in (INTO_LANE_1, [(0.0, 4.0), (3.0, 4.0), (6.0, 5.0), (12.0, 5.0)]):
        assert list(lane_merges(situation(changing(EGO, 185.0, 14.0, lanes), yielding))) == []


def test_mirrored_traffic_has_mirrored_events() -> None:
    scenario = Scenario.load("demo")
    sides = {"left": "right", "right": "left"}
    there = events_in(Situation.of(scenario.log, scenario.lane_map))
    back = events_in(Situation.of(mirrored_log(scenario.log), mirrored_lanes(scenario.lane_map)))
    assert {event.kind for event in there} >= {EventKind.CUT_IN, EventKind.LANE_CHANGE, EventKind.MERGE}
    assert [as_plain(event, {}) for event in back] == [as_plain(event, sides) for event in there]


def as_plain(event: Event, sides: dict[str, str]) -> tuple[object, ...]:
    numbers = {name: sides.get(str(value), value) for name, value in event.numbers.items()}
    rounded = {name: round(value, 2) if isinstance(value, float) else value for name, value in numbers.items()}
    steps = (event.begin, event.step, event.end)
    return (event.kind, event.ego, event.other, *steps, round(event.severity, 2), rounded)
