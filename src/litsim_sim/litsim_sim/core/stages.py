"""Names of the stages of a graph, their states, and why and when a run ends."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any

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


class EndReason(StrEnum):
    """Why a run ends; SENTENCES says it for users."""

    TIME = "time"
    NET_END = "net_end"
    CONTACT = "contact"  # if the scenario ends runs after that
    LOG_OVER = "log_over"


SENTENCES = {
    EndReason.TIME: "all steps of the scenario are done",
    EndReason.NET_END: "the ego has left the net at its end",
    EndReason.CONTACT: "the ego has touched another agent",
    EndReason.LOG_OVER: "the ego's log, which it followed, is over",
}


@dataclass(frozen=True)
class RunEnd:
    """The end of a run.

    Attributes:
        reason: why the run ends.
        step: last step; if the ego has left, the first one without it.
        lane: SUMO id of the lane by which the ego has left the net; empty if it has not.
    """

    reason: EndReason
    step: int
    lane: str = ""

    @property
    def sentence(self) -> str:
        """The reason as text."""
        return SENTENCES[self.reason] + (f", by lane {self.lane}" if self.lane else "")

    def plain(self) -> dict[str, Any]:
        """Returns the fields as values for YAML and JSON; the inverse of :meth:`of_plain`."""
        return {"reason": str(self.reason), "step": self.step, "lane": self.lane}

    @classmethod
    def of_plain(cls, fields: Any) -> RunEnd | None:
        """Inverts :meth:`plain`; returns None if `fields` is malformed."""
        try:
            return cls(EndReason(fields["reason"]), int(fields["step"]), str(fields["lane"]))
        except (KeyError, TypeError, ValueError):
            return None
