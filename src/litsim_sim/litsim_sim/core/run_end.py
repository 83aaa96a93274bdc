"""Why and when a run is over."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class EndReason(StrEnum):
    """Why no step follows the last one of a run."""

    TIME = "time"  # all steps of the scenario are done
    NET_END = "net_end"  # the ego has passed an end of the net: it has come through
    CONTACT = "contact"  # the ego has touched another agent, and the scenario asks for no more
    LOG_OVER = "log_over"  # the ego followed its log to where that ends, and is gone with it


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
        reason: why it is over.
        step: the last step; where the ego has left, the first one without it.
        lane: SUMO's name of the lane by which the ego has left the net; empty where it has not.
    """

    reason: EndReason
    step: int
    lane: str = ""

    @property
    def sentence(self) -> str:
        """Why the run is over, in words."""
        return SENTENCES[self.reason] + (f", by lane {self.lane}" if self.lane else "")

    def plain(self) -> dict[str, Any]:
        """The fields as YAML and JSON know them; :meth:`of_plain` makes the same of them."""
        return {"reason": str(self.reason), "step": self.step, "lane": self.lane}

    @classmethod
    def of_plain(cls, fields: Any) -> RunEnd | None:
        """The end that :meth:`plain` has told; None where `fields` is nothing of the kind."""
        try:
            return cls(EndReason(fields["reason"]), int(fields["step"]), str(fields["lane"]))
        except (KeyError, TypeError, ValueError):
            return None
