"""Names of the stages of a graph, and their states."""

from __future__ import annotations

from enum import IntEnum

BRIDGE = "bridge"
RECORDER = "recorder"
PREDICTOR = "predictor"
CONFLICT = "conflict"
POLICY = "policy"
EGO = "ego"

POLICY_STAGES = (PREDICTOR, CONFLICT, POLICY)
"""Stages of a run whose background is driven by a policy, in the order in which a step goes through them."""


class StageState(IntEnum):
    """State of a stage in a run, numbered as in ``litsim_msgs/StageStatus``.

    The bridge reports ENDING before FINISHED if a run ends early: no step follows the one named.
    """

    READY = 0
    RUNNING = 1
    FINISHED = 2
    FAILED = 3
    ENDING = 4
