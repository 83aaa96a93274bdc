"""Changes of lane by MOBIL: against the formula by hand, and what makes them unsafe."""

import numpy as np
import pytest
from tests.helpers.made_lanes import made_lane

from litsim_policy.motion.along_path import along_paths
from litsim_policy.motion.car_following import IdmConfig, idm_acceleration
from litsim_policy.motion.lane_change import POLITENESS, LaneChanges, weigh_changes
from litsim_policy.motion.lane_lines import LaneLines
from litsim_sim.core.scene import AgentTable
from litsim_sim.lane_map.lane_map import LaneMap

RIGHT, LEFT = 0, 1
LENGTH = 4.5
IDM = IdmConfig(headway=0.5, standstill_gap=1.5, acceleration=2.0, deceleration=2.5)
ME, SPEED, WANTED = 1, 10.0, 15.0
SLOW = {"id": 2, "x": 120.0, "speed": 9.0}


@pytest.fixture(scope="module")
def lines() -> LaneLines:
    return LaneLines(
        LaneMap([made_lane("e_0", (0, 0), (500, 0), left="e_1"), made_lane("e_1", (0, 3.5), (500, 3.5), right="e_0")])
    )


@pytest.fixture
def weigh(lines, agent_table):
    def weigh(*others: dict[str, float], claimed: int | None = None, reach: float = 40.0) -> LaneChanges:
        """What a change to the left brings the one at x = 100."""
        table: AgentTable = agent_table(
            0, *({"y": 0.0} | agent for agent in ({"id": ME, "x": 100.0, "speed": SPEED}, *others))
        )
        rows, line = table.rows(np.array([ME])), lines.rows(np.array([RIGHT, LEFT]))
        poses = np.full(2, 100.0), np.array([0.0, 3.5]), np.zeros(2)
        view = along_paths(lines.batch, table, np.repeat(rows, 2), poses=poses, path=line)
        comes = np.zeros((1, len(table)), np.bool_)
        if claimed is not None:
            comes[0, table.row(claimed)] = True
        return weigh_changes(table, rows, np.array([WANTED]), view, comes, np.array([reach]))

    return weigh


def behind(speed: float, wanted: float, gap: float, leader: float) -> float:
    return float(idm_acceleration(IDM, speed, wanted, np.array([gap]), np.array([leader])))


def free(speed: float, wanted: float) -> float:
    return float(idm_acceleration(IDM, speed, wanted, np.empty(0), np.empty(0)))


def test_a_free_lane_gains_what_the_leader_costs(weigh) -> None:
    found = weigh(SLOW)
    assert found.gain[0] == pytest.approx(free(SPEED, WANTED) - behind(SPEED, WANTED, 20.0 - LENGTH, 9.0))
    assert found.safe[0]


def test_gains_and_losses_of_both_followers_count_by_politeness(weigh) -> None:
    old, new = {"id": 3, "x": 85.0, "speed": 10.0}, {"id": 4, "x": 60.0, "y": 3.5, "speed": 12.0}
    alone, found = weigh(SLOW), weigh(SLOW, old, new)
    old_gap, lead_gap, new_gap = 15.0 - LENGTH, 20.0 - LENGTH, 40.0 - LENGTH
    gains = behind(10.0, 10.0, old_gap + LENGTH + lead_gap, 9.0) - behind(10.0, 10.0, old_gap, SPEED)
    loses = behind(12.0, 12.0, new_gap, SPEED) - free(12.0, 12.0)
    assert loses < 0.0 < gains
    assert found.gain[0] - alone.gain[0] == pytest.approx(POLITENESS * (gains + loses))


@pytest.mark.parametrize(
    ("other", "safe"),
    [
        ({"x": 80.0, "speed": 10.0}, True),
        ({"x": 80.0, "speed": 18.0}, False),  # comes too fast
        ({"x": 94.0, "speed": 8.0}, False),  # less than gap_min behind, though slower
        ({"x": 101.0, "speed": 10.0}, False),  # alongside
        ({"x": 112.0, "speed": 10.0}, True),
        ({"x": 106.0, "speed": 10.0}, False),  # less than gap_min ahead
        ({"x": 115.0, "speed": 0.0}, False),  # stands there
    ],
)
def test_a_change_is_safe_where_nobody_has_to_brake_hard(weigh, other, safe) -> None:
    assert weigh(SLOW, {"id": 4, "y": 3.5} | other).safe[0] == safe


def test_who_is_coming_into_the_lane_counts_as_being_there(weigh) -> None:
    third_lane = {"id": 4, "x": 100.5, "y": 7.0, "speed": 10.0}
    assert weigh(SLOW, third_lane).safe[0]
    assert not weigh(SLOW, third_lane, claimed=4).safe[0]


def test_nobody_swings_out_who_would_touch_the_leader_first(weigh) -> None:
    stands = {"id": 2, "x": 115.0, "speed": 0.0}
    assert weigh(stands, reach=15.0).safe[0] and not weigh(stands, reach=40.0).safe[0]
    assert weigh(stands | {"speed": 10.0}, reach=40.0).safe[0], "one as fast as oneself is never reached"


def test_lines_begin_before_their_lanes_and_know_who_is_beside() -> None:
    lane_map = LaneMap(
        [
            made_lane("a_0", (0, 0), (100, 0), ("b_0",)),
            made_lane("b_0", (100, 0), (200, 0), left="b_1"),
            made_lane("b_1", (100, 3.5), (200, 3.5), right="b_0"),
        ]
    )
    lines, (a, b, c) = LaneLines(lane_map), (lane_map.row(name) for name in ("a_0", "b_0", "b_1"))
    assert lines.left[[a, b, c]].tolist() == [-1, c, -1] and lines.right[[a, b, c]].tolist() == [-1, -1, b]
    line = lines.rows(np.array([b, c]))
    assert lines.rows(np.array([c, b, c])).tolist() == line[[1, 0, 1]].tolist() and len(lines.batch.counts) == 2
    s = lines.batch.project(line, np.array([50.0, 150.0]), np.zeros(2)).s
    assert s == pytest.approx([50.0, 50.0]), "from where the lane before begins; nothing leads into the other"


def test_lines_know_how_far_they_lead_beside_each_other() -> None:
    """Over a junction until a ramp branches off, until a lane ends, and for good where both leave the net."""
    lane_map = LaneMap(
        [
            made_lane("a_0", (0, 0), (100, 0), (":j_0",), left="a_1"),
            made_lane("a_1", (0, 3.5), (100, 3.5), (":k_0",), right="a_0", left="a_2"),
            made_lane("a_2", (0, 7.0), (100, 7.0), (":l_0",), right="a_1"),
            made_lane(":j_0", (100, 0), (120, -1), ("ramp_0",)),
            made_lane(":k_0", (100, 3.5), (120, 3.5), ("b_0",)),
            made_lane(":l_0", (100, 7.0), (120, 7.0), ("b_1",)),
            made_lane("ramp_0", (120, -1), (300, -30)),
            made_lane("b_0", (120, 3.5), (200, 3.5), ("c_0",), left="b_1"),
            made_lane("b_1", (120, 7.0), (200, 7.0), right="b_0"),
            made_lane("c_0", (200, 3.5), (300, 3.5)),
        ]
    )
    lines = LaneLines(lane_map)

    def beside(lane: str, other: str) -> float:
        return float(lines.beside(np.array([lane_map.row(lane)]), np.array([lane_map.row(other)]))[0])

    assert beside("a_0", "a_1") == beside("a_1", "a_0") == 100.0, "then one is on the ramp"
    assert beside("a_1", "a_2") == beside("a_2", "a_1") == 200.0, "with 20 m inside the junction; then one ends"
    two = LaneMap([made_lane("e_0", (0, 0), (50, 0), left="e_1"), made_lane("e_1", (0, 3.5), (50, 3.5), right="e_0")])
    assert np.isinf(LaneLines(two).beside(np.array([0, 1]), np.array([1, 0]))).all()


def test_a_change_that_has_begun_goes_on_unless_somebody_closes_in(weigh) -> None:
    """The model finds 9 m at the same speed too little to begin; who is there already only looks for danger."""
    near = {"id": 4, "x": 86.5, "y": 3.5}
    found = weigh(SLOW, near | {"speed": 14.0})
    assert not found.safe[0] and found.room[0]
    assert not weigh(SLOW, near | {"speed": 19.0}).room[0]
    assert not weigh(SLOW, near | {"x": 97.0, "speed": 10.0}).room[0]
