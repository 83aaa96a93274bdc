"""Takeovers for tests that need only some of their fields."""

from typing import Any

import numpy as np

from litsim_sim.core.takeover import Takeover, TakeoverReason, TakeoverState, TakeoverTable


def takeover(agent: int, opponent: int = 1, **values: Any) -> Takeover:
    """`agent` is held for its conflict with `opponent`, exactly where its log is; `values` of other fields."""
    usual: dict[str, Any] = {
        "state": TakeoverState.HELD,
        "reason": TakeoverReason.CONFLICT,
        "detected_step": 0,
        "time_to_conflict": 1.0,
        "overlap_probability": 0.5,
        "conflict_pose": (0.0, 0.0, 0.0),
        "goal_pose": (0.0, 0.0, 0.0),
        "reference_path": np.zeros((0, 2)),
        "log_collision_predicted": True,
        "residual_position": 0.0,
        "residual_speed": 0.0,
    }
    return Takeover(agent, opponent, **(usual | values))


def takeovers_in_region(step: int, *agents: int) -> TakeoverTable:
    """Takeovers as those of the baselines, along the middle lane of ``us101_like``."""
    path = np.array([[50.0, -5.49], [600.0, -5.49]])
    return TakeoverTable(
        step, tuple(takeover(each, reason=TakeoverReason.REGION, reference_path=path) for each in agents)
    )
