"""Agents that come over the wire are such as a bridge sends, or are refused in one line; the same of controls."""

from array import array
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from litsim_msgs.msg import AgentStates, Controls

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import ARRAY_FIELDS, ControlTable
from litsim_sim.nodes.responses import check_controls
from litsim_sim.ros import messages
from wire import damaged, taken

EGO = 7


def agents() -> AgentStates:
    floats = {name: array("d", [1.0, 2.0, 3.0]) for name in ARRAY_FIELDS[3:]}
    return AgentStates(run_id="run", id=[1, EGO, 9], kind=[0, 1, 2], controller=[0, 2, 1], **floats)


def controls() -> Controls:
    floats = {name: array("d", [1.0, 2.0, 3.0]) for name in ("acceleration", "lateral_acceleration", "yaw_rate")}
    return Controls(run_id="run", id=[1, 2, 9], source=[1, 2, 5], **floats)


def checked_controls(message: Controls) -> ControlTable:
    table = ControlTable.of_message(message)
    check_controls(table, EGO)
    return table


def assert_sound(table: Any) -> None:
    columns = [getattr(table, field.name) for field in fields(table) if field.name != "step"]
    assert {len(each) for each in columns} == {len(table.id)}
    assert (np.diff(table.id) > 0).all()
    assert all(np.isfinite(each).all() for each in columns)


@settings(max_examples=150)
@given(damaged(agents()))
def test_agents_are_sound_or_refused(message: AgentStates) -> None:
    table = taken(messages.received_agents, message, InputError, "/litsim/agents: ")
    if table is not None:
        assert_sound(table)


@settings(max_examples=150)
@given(damaged(controls()))
def test_controls_are_sound_or_refused(message: Controls) -> None:
    table = taken(checked_controls, message, ValueError)
    if table is not None:
        assert_sound(table)
        assert EGO not in table.id


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("x", [1.0, float("nan"), 3.0], "x of agent 7 is nan, expected a finite number"),
        ("speed", [], "speed has 0 values, expected 3, as many as id"),
        ("id", [1, 7, 7], "id 7 follows 7, expected ids that ascend"),
        ("id", [7, 1, 9], "id 1 follows 7, expected ids that ascend"),
    ],
)
def test_what_is_wrong_is_named(field: str, value: list[Any], expected: str) -> None:
    message = agents()
    setattr(message, field, value)
    with pytest.raises(InputError) as raised:
        messages.received_agents(message)
    assert str(raised.value) == f"/litsim/agents: {expected}"


def test_what_is_sound_comes_through() -> None:
    assert messages.received_agents(agents()).id.tolist() == [1, 7, 9]
    assert len(messages.received_agents(AgentStates())) == 0
    check_controls(ControlTable.of_message(controls()), EGO)
    check_controls(ControlTable.empty(3), EGO)


def test_odd_messages_are_drawn() -> None:
    """Else the properties above would be of little."""
    found = {"refused": 0, "sound": 0}

    @settings(max_examples=200, database=None)
    @given(damaged(agents()), st.none())
    def count(message: AgentStates, _: None) -> None:
        sound = taken(messages.received_agents, message, InputError) is not None
        found["sound" if sound else "refused"] += 1

    count()
    assert min(found.values()) > 30
