"""Whom a predictor looks at, and whose forecast somebody reads."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from litsim_predictor.forecast import (
    MEETING_AHEAD,
    MEETING_ASIDE,
    MEETING_S,
    Wanted,
    agents_read,
    selected,
)
from litsim_sim.core.scene import AgentTable, Controller

Build = Callable[..., AgentTable]
EGO, ROI = 1, 30.0


# the region of interest


def interesting(table: AgentTable, roi_m: float = ROI) -> list[int]:
    return selected(table, EGO, roi_m, Wanted.ALL)[0].id.tolist()


def test_the_region_is_a_circle_around_the_ego_with_its_border(agent_table: Build) -> None:
    around = [{"id": 2, "x": 30.0}, {"id": 3, "x": 30.001}, {"id": 4, "x": -18.0, "y": 24.0}, {"id": 5, "y": -31.0}]
    table = agent_table(0, {"id": EGO}, *around, {"id": 6, "x": 25.0, "y": 25.0})
    assert interesting(table) == [EGO, 2, 4]
    assert interesting(table, 40.0) == [EGO, 2, 3, 4, 5, 6]
    assert interesting(table, 10.0) == [EGO]


def test_whoever_is_off_its_log_has_a_region_of_its_own(agent_table: Build) -> None:
    far = [{"id": 2, "x": 200.0}, {"id": 3, "x": 225.0}, {"id": 4, "x": 250.0}]
    on_log = agent_table(0, {"id": EGO}, *far)
    assert interesting(on_log) == [EGO]
    taken_over = agent_table(0, {"id": EGO}, {**far[0], "controller": Controller.POLICY}, *far[1:])
    assert interesting(taken_over) == [EGO, 2, 3]


def test_once_the_ego_has_left_only_those_off_their_log_matter(agent_table: Build) -> None:
    on_log = agent_table(0, {"id": 2}, {"id": 3, "x": 5.0})
    assert interesting(on_log) == []
    assert interesting(agent_table(0, {"id": 2, "controller": Controller.POLICY}, {"id": 3, "x": 5.0})) == [2, 3]
    assert interesting(AgentTable.empty(0)) == []


@given(st.lists(st.tuples(st.floats(-80, 80), st.floats(-80, 80), st.sampled_from(Controller)), max_size=12))
def test_the_region_is_what_its_definition_says(
    agent_table: Build, agents: list[tuple[float, float, Controller]]
) -> None:
    rows = [{"id": 1 + i, "x": x, "y": y, "controller": c} for i, (x, y, c) in enumerate(agents)]
    table = agent_table(0, *rows)
    centres = [r for r in rows if r["id"] == EGO or r["controller"] != Controller.LOG]
    unsure = {r["id"] for r in rows for c in centres if abs(np.hypot(r["x"] - c["x"], r["y"] - c["y"]) - ROI) < 1e-9}
    near = {r["id"] for r in rows if any(np.hypot(r["x"] - c["x"], r["y"] - c["y"]) <= ROI for c in centres)}
    assert set(interesting(table)) - unsure == near - unsure


# whose forecast is read


def read(table: AgentTable) -> list[int]:
    near, rows = selected(table, EGO, 1e6, Wanted.READ)
    return near.id[rows].tolist()


def read_beside_the_ego(build: Build, **other: float) -> bool:
    """Whether the forecast of an agent on its log is read, with the ego at the origin at 10 m/s along x."""
    size = {"length": 4.0, "width": 2.0}
    return read(build(0, {"id": EGO, "speed": 10.0, **size}, {"id": 2, "speed": 10.0, **size, **other})) == [EGO, 2]


def test_forecasts_of_the_ego_and_of_those_off_their_log_are_read(agent_table: Build) -> None:
    driven = {"id": 3, "x": 300.0, "controller": Controller.POLICY}
    ahead, elsewhere = {"id": 4, "x": 310.0}, {"id": 5, "y": 100.0}
    assert read(agent_table(0, {"id": EGO}, {"id": 2, "x": 200.0}, driven, ahead, elsewhere)) == [EGO, 3, 4]
    assert read(agent_table(0, {"id": 2}, {"id": 4, "x": 5.0})) == []
    assert read(AgentTable.empty(0)) == []


def test_those_who_may_come_close_to_one_off_its_log_are_read(agent_table: Build) -> None:
    """Boxes of 4 m by 2 m; in the ego's lane or beside it, ahead of it or behind."""
    for x in (4.0 + MEETING_AHEAD - 0.1, -4.0 - MEETING_AHEAD + 0.1):
        assert read_beside_the_ego(agent_table, x=x)
        assert read_beside_the_ego(agent_table, x=x, y=2.0 + MEETING_ASIDE - 0.1)
        assert not read_beside_the_ego(agent_table, x=x, y=2.0 + MEETING_ASIDE + 0.1)
        assert not read_beside_the_ego(agent_table, x=x + 0.2 * np.sign(x))


@pytest.mark.parametrize(("closing", "comes"), [(0.9, False), (1.1, True), (-1.1, False)])
def test_who_comes_closer_in_time_is_read_and_who_leaves_is_not(
    agent_table: Build, closing: float, comes: bool
) -> None:
    """60 m behind, so many times faster than to be just within reach when the time is up."""
    faster = closing * (60.0 - 4.0 - MEETING_AHEAD) / MEETING_S
    assert read_beside_the_ego(agent_table, x=-60.0, speed=10.0 + faster) == comes
    across = {"y": -60.0, "yaw": np.pi / 2, "speed": 25.0}
    assert read_beside_the_ego(agent_table, x=10.0 * 60.0 / 25.0, **across)
    assert not read_beside_the_ego(agent_table, x=10.0 * 60.0 / 25.0 - 60.0, **across)


vehicles = st.tuples(
    st.floats(-60, 60), st.floats(-60, 60), st.floats(-3.1, 3.1), st.floats(0, 30), st.sampled_from(Controller)
)


@given(st.lists(vehicles, max_size=8))
def test_whose_forecast_is_read_is_what_its_definition_says(
    agent_table: Build, agents: list[tuple[float, float, float, float, Controller]]
) -> None:
    rows = [
        {"id": 1 + i, "x": x, "y": y, "yaw": yaw, "speed": speed, "controller": Controller.POLICY}
        for i, (x, y, yaw, speed, controller) in enumerate(agents)
    ]
    table = agent_table(0, *rows)
    off = (table.id == EGO) | (table.controller != Controller.LOG)
    times = np.linspace(0.0, MEETING_S, 301)
    found = agents_read(table, off)
    for i in range(len(table)):
        slack = np.full(1, np.inf)
        for j in np.flatnonzero(off):
            dx = table.x[j] - table.x[i] + times * (table.speed[j] * np.cos(table.yaw[j]))
            dx = dx - times * table.speed[i] * np.cos(table.yaw[i])
            dy = table.y[j] - table.y[i] + times * (table.speed[j] * np.sin(table.yaw[j]))
            dy = dy - times * table.speed[i] * np.sin(table.yaw[i])
            along = np.abs(np.cos(table.yaw[i]) * dx + np.sin(table.yaw[i]) * dy)
            across = np.abs(np.cos(table.yaw[i]) * dy - np.sin(table.yaw[i]) * dx)
            along = along - 0.5 * (table.length[i] + table.length[j]) - MEETING_AHEAD
            across = across - 0.5 * (table.width[i] + table.width[j]) - MEETING_ASIDE
            slack = np.minimum(slack, np.maximum(along, across).min())
        assume(abs(slack[0]) > 1.0 or off[i])  # closer to the border, it depends on the instants
        assert found[i] == (off[i] or slack[0] < 0.0)


# selected


def test_who_is_wanted_can_be_chosen(agent_table: Build) -> None:
    beside, beyond = {"id": 3, "y": 10.0}, {"id": 4, "x": 100.0}
    table = agent_table(0, {"id": EGO}, {"id": 2, "x": 15.0}, beside, beyond)
    for wanted, expected in ((Wanted.ALL, [EGO, 2, 3]), (Wanted.READ, [EGO, 2]), (Wanted.EGO, [EGO])):
        agents, rows = selected(table, EGO, ROI, wanted)
        assert agents.id.tolist() == [EGO, 2, 3]
        assert agents.id[rows].tolist() == expected
    for wanted in Wanted:
        agents, rows = selected(agent_table(0, {"id": 2}), EGO, ROI, wanted)
        assert len(agents) == len(rows) == 0
