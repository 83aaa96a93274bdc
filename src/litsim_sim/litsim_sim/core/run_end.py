"""Why and when a run ends."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any


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
