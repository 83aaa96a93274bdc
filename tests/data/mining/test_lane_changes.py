"""Lane changes: where they begin and end, and what is none."""

from collections.abc import Iterator
from itertools import pairwise

import pytest

from litsim_data.mining.events import Situation
from litsim_data.mining.lane_changes import CENTRE_M, LaneChange
from litsim_data.mining.lane_tracks import runs
from litsim_sim.core.scene import STEP_S
from litsim_sim.scenario.scenario import Scenario
from made_traffic import LANE_WIDTH, STREET, changing, on_path, situation, straight

WITHIN_S = 3.5  # the column of a recording and the fitted lanes put the border elsewhere


def test_a_change_begins_off_the_old_centre_line_and_ends_near_the_new_one() -> None:
    # At 1 m/s across, from 4 s on: off by 0.375 m after 0.375 s, over the border after 1.83 s, near after 3.285 s.
    vehicle = changing(1, 20.0, 15.0, [(0.0, 2.0), (4.0, 2.0), (4.0 + LANE_WIDTH, 1.0), (12.0, 1.0)])
    (change,) = situation(vehicle).changes
    assert change.left
    assert change.begin * STEP_S == pytest.approx(4.0 + CENTRE_M, abs=STEP_S)
    assert change.cross * STEP_S == pytest.approx(4.0 + 0.5 * LANE_WIDTH, abs=STEP_S)
    assert change.end * STEP_S == pytest.approx(4.0 + LANE_WIDTH - CENTRE_M, abs=STEP_S)
    assert change.duration_s == pytest.approx(LANE_WIDTH - 2 * CENTRE_M, abs=2 * STEP_S)
    assert change.lateral_speed == pytest.approx(1.0, abs=0.02)


def test_a_change_over_the_border_of_two_edges_is_one() -> None:
    # At 176 m `upstream` becomes `weave`, whose lanes have other numbers; the vehicle is there when it is between two.
    vehicle = changing(1, 176.0 - 15.0 * 6.0, 15.0, [(0.0, 3.0), (4.0, 3.0), (8.0, 2.0), (12.0, 2.0)])
    assert [change.left for change in situation(vehicle).changes] == [True]


@pytest.mark.parametrize(
    "lanes",
    [
        pytest.param([(0.0, 2.0), (12.0, 2.0)], id="keeps its lane"),
        pytest.param([(0.0, 2.0), (4.0, 2.0), (5.5, 1.4), (7.0, 2.0), (12.0, 2.0)], id="comes back"),
        pytest.param([(0.0, 2.05), (12.0, 1.95)], id="wanders in its lane"),
        pytest.param([(0.0, 1.6), (12.0, 1.42)], id="drifts slower than 0.1 m/s"),
        pytest.param([(0.0, 2.0), (11.0, 2.0), (12.0, 1.4)], id="the log ends on the way"),
    ],
)
def test_what_is_no_lane_change(lanes: list[tuple[float, float]]) -> None:
    assert situation(changing(1, 20.0, 15.0, lanes)).changes == []


def test_two_lanes_are_two_changes() -> None:
    vehicle = changing(1, 20.0, 15.0, [(0.0, 1.0), (2.0, 1.0), (5.0, 2.0), (6.0, 2.0), (9.0, 3.0), (12.0, 3.0)])
    assert [(change.left, change.agent) for change in situation(vehicle).changes] == [(False, 0), (False, 0)]


def test_whoever_stays_off_the_centre_of_its_new_lane_has_changed() -> None:
    vehicle = changing(1, 20.0, 15.0, [(0.0, 2.0), (4.0, 2.0), (6.0, 1.3), (12.0, 1.3)])
    (change,) = situation(vehicle).changes
    assert change.end * STEP_S == pytest.approx(6.0, abs=6 * STEP_S)  # when it no longer moves across


@pytest.mark.parametrize("way", [("WA_2", "AAN_0"), ("WA_0", "AAS_0"), ("ANA_1", "AB_1"), ("BA_1", "AW_1")])
def test_a_way_through_a_junction_is_no_lane_change(way: tuple[str, str]) -> None:
    made = situation(on_path(1, way, 110.0, 8.0), lane_map=STREET)
    assert made.tracks.lane[0, -1] == STREET.row(way[1])
    assert made.changes == []


def test_opposite_carriageways_are_no_neighbours() -> None:
    there, back = on_path(1, ("WA_2", "AAN_0"), 20.0, 8.0), on_path(2, ("BA_1", "AW_1"), 200.0, 8.0)
    made = situation(there, back, lane_map=STREET)
    assert made.changes == []
    assert (made.following.leader == -1).all()


def test_lane_changes_of_the_demo_are_those_of_its_lane_column() -> None:
    scenario = Scenario.load("demo")
    found, column = set(mined(Situation.of_scenario(scenario))), set(column_changes(scenario))
    assert len(found) > 10
    assert found <= column
    last = {vehicle: scenario.log.last_step[scenario.log.row(vehicle)] for vehicle, _, _ in column}
    assert all(last[vehicle] - step < 20 for vehicle, step, _ in column - found)  # the log ends on the way


@pytest.mark.data
def test_lane_changes_of_real_traffic_against_the_lane_column(real_data: object) -> None:
    real_data()  # type: ignore[operator]
    scenario = Scenario.load("us101_0750")
    made, column = Situation.of_scenario(scenario), column_changes(scenario)
    found = mined(made)
    right = [one for one in found if any(_same(one, other) for other in column)]
    there = [other for other in column if any(_same(one, other) for one in found)]
    precision, recall = len(right) / len(found), len(there) / len(column)
    print(f"{len(found)} found, {len(column)} in the column: precision {precision:.2f}, recall {recall:.2f}")
    assert precision > 0.9
    assert recall > 0.85


def mined(made: Situation) -> list[tuple[int, int, bool]]:
    """Vehicle, step and side (left) of every change that was found."""
    return [_key(made, change) for change in made.changes]


def column_changes(scenario: Scenario) -> list[tuple[int, int, bool]]:
    """The same by the recording's own column, which counts lanes from the left; less than 2 s away is no change."""
    found = []
    for vehicle, rows in scenario.recording.table.groupby("vehicle_id"):
        lane, first = rows["lane"].to_numpy(), int(rows["frame"].iloc[0]) - scenario.start_frame
        stays = [[int(lane[begin]), begin, end] for begin, end in runs(lane)]
        away = next(_visits(stays), None)
        while away is not None:
            stays[away - 1 : away + 2] = [[stays[away - 1][0], stays[away - 1][1], stays[away + 1][2]]]
            away = next(_visits(stays), None)
        found += [(int(vehicle), first + new[1], new[0] < old[0]) for old, new in pairwise(stays)]
    return found


def _visits(stays: list[list[int]]) -> Iterator[int]:
    for at in range(1, len(stays) - 1):
        if stays[at - 1][0] == stays[at + 1][0] and stays[at][2] - stays[at][1] < 20:
            yield at


def _key(made: Situation, change: LaneChange) -> tuple[int, int, bool]:
    return int(made.log.ids[change.agent]), change.cross, change.left


def _same(one: tuple[int, int, bool], other: tuple[int, int, bool]) -> bool:
    return one[0] == other[0] and one[2] == other[2] and abs(one[1] - other[1]) * STEP_S <= WITHIN_S


def test_a_vehicle_beside_the_road_is_on_no_lane() -> None:
    made = situation(straight(1, 20.0, 10.0, -4.0))
    assert (made.tracks.lane == -1).all()
    assert made.changes == []
