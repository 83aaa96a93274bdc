"""Takeovers that come over the wire are such as a conflict stage sends, or are refused in one line."""

import numpy as np
import pytest
from hypothesis import given, settings
from litsim_msgs.msg import Takeovers

from litsim_policy.conflict.messages import received_takeovers, takeovers_to_message
from litsim_sim.core.errors import InputError
from litsim_sim.core.takeover import Takeover, TakeoverTable
from made_agents import takeover
from wire import damaged, taken


def held(agent: int) -> Takeover:
    path = np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]])
    return takeover(agent, 13, reference_path=path, residual_position=-1.0)


GOOD = takeovers_to_message(TakeoverTable(5, (held(2), held(8)), 1, converged=True), "run-1")


@settings(max_examples=300)
@given(damaged(GOOD))
def test_takeovers_are_sound_or_refused(message: Takeovers) -> None:
    table = taken(received_takeovers, message, InputError, "/litsim/takeovers: ")
    if table is None:
        return
    agents = [each.agent for each in table.takeovers]
    assert agents == sorted(set(agents))
    for each in table.takeovers:
        numbers = [each.time_to_conflict, each.overlap_probability, *each.conflict_pose, *each.goal_pose]
        assert np.isfinite([*numbers, each.residual_position, each.residual_speed, each.time_shift]).all()
        assert np.isfinite(each.reference_path).all() and each.reference_path.shape[1:] == (2,)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("state", 9, "9 is not a valid TakeoverState"),
        ("agent", 8, "id 8 follows 8, expected ids that ascend"),
        ("time_shift", float("nan"), "time_shift of agent 2 is nan, expected a finite number"),
        ("reference_path", [1.0, 2.0, 3.0], "reference_path of agent 2 has 3 values, expected x and y of each point"),
        ("reference_path", [1.0, float("inf")], "reference_path of agent 2 is not finite, expected finite numbers"),
    ],
)
def test_what_is_wrong_is_named(field: str, value: object, expected: str) -> None:
    message = takeovers_to_message(TakeoverTable(5, (held(2), held(8)), 1, converged=True), "run-1")
    setattr(message.takeovers[0], field, value)
    with pytest.raises(InputError) as raised:
        received_takeovers(message)
    assert str(raised.value) == f"/litsim/takeovers: {expected}"


def test_takeovers_of_some_and_of_nobody_come_through() -> None:
    assert [each.agent for each in received_takeovers(GOOD).takeovers] == [2, 8]
    assert received_takeovers(Takeovers()) == TakeoverTable.of_message(Takeovers())
