"""Why a moment of recorded traffic makes no encounter."""

from __future__ import annotations

from enum import StrEnum


class Lack(StrEnum):
    """What lacks for an encounter, as a sentence; in the order in which it is looked for."""

    SHORT = "the record of the two is too short"
    FAR = "the leader is too near or too far"
    JUMP = "the record jumps"
    RECORD = "the record has an overlap"
    IDLE = "the opponent keeps its pace, too"
    EASY = "the agent need not react"
    LOG = "at their pace, the two would touch"
    OTHERS = "at its pace, the agent would touch another vehicle"
