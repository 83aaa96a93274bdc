"""Whether the ego drives where it is to drive: along its route, and to its goal."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.measures.mission import mission
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.results import what_happened
from litsim_sim.core.scene import AgentTable
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.run import Run
from litsim_sim.scenario.mission import Mission
from litsim_sim.scenario.scenario import packaged
from made_runs import make_run, table

NET = packaged("nets/urban_like.net.xml")
STREET = LaneMap.from_net(NET)
CRITERIA = {criterion.field: criterion for criterion in Criteria.load().runs}
STRAIGHT, RIGHT = ("WA_0", ":A_11_0", "AB_0"), ("WA_0", ":A_10_0", "AAS_0")


def along(lanes: tuple[str, ...], steps: int = 81) -> list[AgentTable]:
    """The ego at 10 m/s along lanes, from 20 m before the end of the first on."""
    rows = [STREET.row(name) for name in lanes]
    begin = STREET.lanes[rows[0]].length - 20.0
    edges = frozenset(STREET.lanes[row].edge_id for row in rows)
    path = STREET.path_from(rows[0], begin, float(steps), edges)
    s = np.append(0.0, np.cumsum(np.hypot(*np.diff(path, axis=0).T)))
    x, y = (np.interp(np.arange(steps + 1.0), s, path[:, axis]) for axis in (0, 1))
    yaw = np.arctan2(np.diff(y), np.diff(x))
    return [table(k, {"id": 1, "x": x[k], "y": y[k], "yaw": yaw[k]}) for k in range(steps)]


def given(goal: AgentTable, lanes: tuple[str, ...]) -> Mission:
    on_route = np.array([lane.id in lanes for lane in STREET.lanes])
    pose = np.array([float(getattr(goal, name)[0]) for name in ("x", "y", "yaw")])
    return Mission(np.zeros((2, 2)), pose, on_route, np.full(len(on_route), np.nan))


@pytest.fixture
def run() -> Callable[..., Run]:
    def make(driven: tuple[str, ...], **values: Any) -> Run:
        log = along(RIGHT)
        usual = {"log": log, "mission": given(log[-1], RIGHT), "net_xml": NET.read_bytes()}
        return make_run(along(driven), **(usual | values))

    return make


def test_an_ego_that_turns_as_its_log(run: Any) -> None:
    measured = mission(run(RIGHT))
    assert measured["progress_ratio"] == 1.0 and measured["progress_m"] == pytest.approx(80.0, abs=1.0)
    assert (measured["off_route_m"], measured["left"], measured["goal_m"]) == (0.0, [], 0.0)
    assert measured["goal_reached"] is None, "no goal is named: the log ends somewhere"


def test_an_ego_that_goes_straight_on_where_its_log_turns_fails(run: Any) -> None:
    measured = mission(run(STRAIGHT))
    inside = STREET.lanes[STREET.row(":A_11_0")].length
    assert measured["off_route_m"] == pytest.approx(80.0 - 20.0 - inside, abs=1.5)
    ((step, lane),) = [(each["step"], each["lane"]) for each in measured["left"]]
    assert lane == "AB_0" and step == pytest.approx(20.0 + inside, abs=1.5)
    assert 0.2 < measured["progress_ratio"] < 0.6, "more than the criterion of progress asks for"
    result = CRITERIA["mission.off_route_m"].of_run({"mission": measured})
    assert not result.passed
    text = what_happened(result.field, result.value, result.limit, {"mission": measured})
    assert text == (
        f"the ego left its route at {0.1 * step:.1f} s onto lane AB_0, and drove {measured['off_route_m']:.0f} m "
        "beside it, expected at most 10 m"
    )


def test_beyond_the_last_edge_of_its_log_the_ego_may_drive_anywhere(run: Any) -> None:
    """The log ends before the junction."""
    whole = run(STRAIGHT)
    short = whole.log[:10]
    measured = mission(run(STRAIGHT, log=short, mission=given(short[-1], RIGHT)))
    assert mission(whole)["off_route_m"] > 20.0 and measured["off_route_m"] == 0.0


def test_a_goal_that_is_named_is_reached_or_not(run: Any) -> None:
    named = {"scenario_yaml": "goal: [1.0, 2.0, 0.0]\n"}
    reached, missed = mission(run(RIGHT, **named)), mission(run(STRAIGHT, **named))
    assert (reached["goal_reached"], missed["goal_reached"]) == (True, False)
    assert reached["progress_ratio"] is None, "the log drives elsewhere"
    assert "its goal is named" in what_happened("mission.progress_ratio", None, "at least 0.2", {"mission": missed})
    limit = CRITERIA["mission.goal_reached"]
    text = what_happened(limit.field, missed["goal_reached"], limit.limit, {"mission": missed})
    assert text.startswith("the ego did not reach its goal: it came within ")


def test_a_record_without_a_mission_says_so_and_does_not_pass(run: Any) -> None:
    assert mission(run(RIGHT, mission=None)) is None
    result = CRITERIA["mission.off_route_m"].of_run({"mission": None})
    assert not result.passed
    assert what_happened(result.field, None, result.limit, {}).startswith("the ego's mission is not recorded")
