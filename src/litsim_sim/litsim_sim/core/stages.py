"""The parts of a graph by name, and the states in which they may be."""

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
    """What a stage says of its part in a run; numbered as in ``litsim_msgs/StageStatus``.

    The bridge says ENDING, before FINISHED, where a run is over before its time: no step follows the one that it names.
    """

    READY = 0
    RUNNING = 1
    FINISHED = 2
    FAILED = 3
    ENDING = 4
