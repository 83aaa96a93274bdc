"""What policy C is punished for: every term by its own weight."""

from dataclasses import fields

import numpy as np
import pytest

from litsim_policy.driving.task import NOBODY
from litsim_research.policies.reward import NEAR_ACROSS, NEAR_ALONG, Penalties, PenaltyConfig, passed_on, penalties
from litsim_sim.core.geometry import boxes_overlap, to_body
from litsim_sim.core.scene import AgentTable

TERMS = tuple(field.name for field in fields(Penalties))
ADDED = ("collision", "off_road", "displacement", "jerk")
LASTING = tuple(name for name in TERMS if name not in ADDED)
WEIGHTS = PenaltyConfig(**{name: 2.0 + k for k, name in enumerate(TERMS)})


def total(**values: float) -> float:
    """The penalty of one agent with these terms, the others 0."""
    terms = {field.name: np.array([values.get(field.name, 0.0)]) for field in fields(Penalties)}
    return float(Penalties(**terms).total(WEIGHTS)[0])


def test_every_weight_has_its_term() -> None:
    weights = {field.name for field in fields(PenaltyConfig)}
    assert weights - set(TERMS) == {"share", "control"}
    assert all(getattr(PenaltyConfig(), name) > 0.0 for name in (*LASTING, "collision", "off_road"))


@pytest.mark.parametrize("name", TERMS)
def test_every_term_counts_by_its_weight(name: str) -> None:
    assert total() == 0.0
    assert total(**{name: 1.0}) == -getattr(WEIGHTS, name)


def test_of_those_that_last_the_worst_counts_and_the_others_come_on_top() -> None:
    worst = max(getattr(WEIGHTS, name) for name in LASTING)
    assert total(**dict.fromkeys(LASTING, 1.0)) == -worst
    added = sum(getattr(WEIGHTS, name) for name in ADDED)
    assert total(**dict.fromkeys(TERMS, 1.0)) == -(worst + added)
    assert total(edge=0.5) == pytest.approx(-0.5 * WEIGHTS.edge)
    assert total(displacement=-0.5) == pytest.approx(0.5 * WEIGHTS.displacement), "nearer to the log"


def test_every_step_under_control_costs_the_same() -> None:
    terms = Penalties(**{name: np.zeros(2) for name in TERMS})
    assert terms.total(PenaltyConfig(control=0.25)).tolist() == [-0.25, -0.25]


def test_what_agents_do_to_those_behind_comes_back_to_them() -> None:
    penalty, agents = np.array([-1.0, -2.0, -4.0, -8.0]), np.array([3, 5, 8, 9])
    because = np.array([NOBODY, 3, 3, 7])  # 7 is not driven
    assert passed_on(penalty, agents, because).tolist() == [-6.0, 0.0, 0.0, 0.0]
    assert passed_on(penalty, agents, np.array([9, 9, 5, 5])).tolist() == [0.0, -12.0, 0.0, -3.0]
    assert passed_on(np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64)).shape == (0,)


@pytest.mark.parametrize("seed", range(8))
def test_contacts_and_nearness_are_what_arrays_of_everybody_give(
    make_scenario, track, agent_table, lane_centres, seed: int
) -> None:
    random, lane_map = np.random.default_rng(seed), make_scenario(track(1, x=100.0)).lane_map
    places = np.column_stack([100.0 + 30.0 * random.random(12), random.choice(lane_centres[:3], 12)])

    def crowd(shift: float) -> AgentTable:
        moved = places + np.random.default_rng(seed + 1).normal(0.0, 1.0, (12, 2)) + [shift, 0.0]
        columns = ({"id": k, "x": x, "y": y, "yaw": 0.1 * k} for k, (x, y) in enumerate(moved.tolist()))
        return agent_table(0, *(agent | {"acceleration": -4.0} for agent in columns if agent["id"] != 3 or shift))

    before, after, agents = crowd(0.0), crowd(0.3), np.array([0, 4, 5, 9])
    found = penalties(before, after, agents, lane_map, np.zeros(4, np.bool_), np.zeros(4))

    def others(table: AgentTable) -> tuple[np.ndarray, np.ndarray]:
        rows = table.rows(agents)
        dx, dy = table.x - table.x[rows, None], table.y - table.y[rows, None]
        ahead, left = to_body(dx, dy, table.yaw[rows, None])
        counts = (ahead > -0.5 * 4.5) & (table.id != agents[:, None])
        size = (np.full(dx.shape, 4.5), np.full(dx.shape, 2.0))
        touching = boxes_overlap(dx, dy, table.yaw[rows, None] + 0 * dx, table.yaw + 0 * dx, size, size) & counts
        apart = np.maximum((np.abs(ahead) - 4.5) / NEAR_ALONG, (np.abs(left) - 2.0) / NEAR_ACROSS)
        return touching, np.clip(1.0 - np.where(counts, apart, np.inf).min(axis=1), 0.0, 1.0)

    (now, near), (earlier, _) = others(after), others(before)
    new = np.insert(~earlier, 3, True, axis=1)  # agent 3 has come onto the road
    assert found.collision.tolist() == (now & new).any(axis=1).tolist()
    assert found.proximity.tolist() == near.tolist()
    assert found.hard_brake == pytest.approx(np.full(4, 1.0 / 1.5))


def test_the_edge_counts_from_half_a_metre_within_to_a_little_beyond(
    make_scenario, track, agent_table, lane_centres
) -> None:
    lane_map = make_scenario(track(1, x=100.0)).lane_map
    # the left edge of the road is at y = 0, and agents are 2 m wide
    offs = (1.6, 1.25, 1.05, 0.85)
    table = agent_table(0, *({"id": k, "x": 100.0 + 20.0 * k, "y": -off} for k, off in enumerate(offs)))
    inside = agent_table(0, *({"id": k, "x": 100.0 + 20.0 * k, "y": lane_centres[1]} for k in range(4)))
    found = penalties(inside, table, np.arange(4), lane_map, np.zeros(4, np.bool_), np.zeros(4))
    assert found.edge == pytest.approx([0.0, 0.5, 5.0 / 6.0, 1.0], abs=0.01)
    assert found.off_road.tolist() == [False, False, False, True]
    assert not penalties(table, table, np.arange(4), lane_map, np.zeros(4, np.bool_), np.zeros(4)).off_road.any()
