"""Publishers that may answer for an external ego: why none does, which ones compete, and which came in mid-run.

Without ROS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from litsim_sim.ego_port.port import EgoPort

PARTICIPANT_BYTES = 12  # length of the prefix of a GUID of DDS


@dataclass(frozen=True)
class EgoPublisher:
    """A publisher on one of the topics of the ego port.

    Attributes:
        topic: its name.
        node: full name of its node; empty if unknown.
        unheard: text that says why the bridge cannot hear it; empty if it can.
        gid: identifier that DDS gives it, and no other.
    """

    topic: str
    node: str
    unheard: str = ""
    gid: bytes = b""

    @property
    def participant(self) -> bytes:
        """The part of :attr:`gid` that all publishers of a process have in common."""
        return self.gid[:PARTICIPANT_BYTES]


def absence(
    port: EgoPort, publishers: Sequence[EgoPublisher], known_nodes: Sequence[str], domain: str, *, clock: bool = True
) -> str:
    """Returns a text that says why an external ego has not answered the current step, as far as known.

    `publishers` are announced now, `known_nodes` had some at any time, and `domain` describes where it should be.
    """
    name = ", ".join(dict.fromkeys([p.node for p in publishers if p.node] or known_nodes))
    prefix = f"{name}: " if name else ""
    expected = [p for p in publishers if p.topic in port.topics]
    elsewhere = ", ".join(dict.fromkeys(p.topic for p in publishers if p.topic not in port.topics))
    if elsewhere and not expected and port.answered < 0:
        return f"{prefix}it publishes on {elsewhere}, expected {port.topics[0]}"
    if port.unfit:
        return f"{prefix}it does not answer this step: {port.unfit}"
    if port.heard:
        end = "is still announced, so it hangs, or has died without leaving" if expected else "has left"
        if expected and all(publisher.unheard for publisher in expected):  # it has made another
            end = expected[0].unheard
        return f"{prefix}it has answered until step {port.answered}; its publisher {end}"
    for publisher in expected:
        if publisher.unheard:
            return f"{prefix}its publisher on {publisher.topic} {publisher.unheard}"
    if not expected:
        return f"{prefix}no node publishes on {' or '.join(port.topics)}; is it running in {domain}?"
    about_timers = (
        "; until step 0 is answered, /clock advances to 0.1 s only, so that longer timers on simulation time do not run"
    )
    text = f"{prefix}it publishes on {expected[0].topic}, but no message has been received"
    return text + (about_timers if clock else "")


def rivalry(port: EgoPort, publishers: Sequence[EgoPublisher]) -> str:
    """Returns a text that says that several of the announced `publishers` answer for the ego; empty if it is one.

    Several are no matter as long as every answer was asked for. Answers on a second input are no matter if they are
    the same process's, or if the user has chosen the input.
    """
    heard = [p for p in publishers if not p.unheard]
    drivers = [p for p in heard if p.topic in port.topics]
    processes, nodes = {p.participant for p in drivers}, {p.node for p in drivers} - {""}
    others = (p for p in heard if p.topic not in port.topics)
    strangers = [p for p in others if p.participant not in processes and p.node not in nodes]
    if port.by_first and port.counts["refused"] and drivers and strangers:
        who = ", ".join(sorted(f"{p.node or '?'} on {p.topic}" for p in [*drivers, *strangers]))
        return (
            f"several nodes answer: {who}; it would depend on chance whose first message decides which of them drives "
            "the ego; end the others, or choose with --ego-interface"
        )
    unasked = sum(port.counts[kind] for kind in ("stale", "future", "surplus"))
    if len(drivers) < 2 or not unasked:
        return ""
    return (
        f"{len(drivers)} publishers are on {port.topics[0]} ({', '.join(sorted(p.node or '?' for p in drivers))}), and "
        f"{unasked} messages there were not asked for: it would depend on chance which of them drives the ego; end the "
        "others, or choose another domain"
    )


class EgoPublishers:
    """The publishers that have answered for an external ego, to notice a stack that is started again in mid-run.

    It answers on as if nothing had happened, but does not know of the steps before its start.
    """

    def __init__(self) -> None:
        self._known: set[bytes] = set()

    @property
    def any_known(self) -> bool:
        """Whether any publisher has been noted."""
        return bool(self._known)

    def note(self, port: EgoPort, publishers: Sequence[EgoPublisher], names: Sequence[str]) -> list[str]:
        """Note the announced publishers; return a text about each that has joined since the first call, at step 0.

        The `port` counts them. `names` stand for nodes that are unknown.
        """
        heard = {p.gid: p for p in publishers if p.topic in port.topics and not p.unheard}
        joined = [p for gid, p in heard.items() if gid not in self._known] if self._known else []
        self._known |= heard.keys()
        port.counts["joined"] += len(joined)
        return [
            f"{p.node or ', '.join(names) or '?'}: its publisher on {p.topic} was not there at step 0; a stack that "
            "has been started again in mid-run answers without what it knew before"
            for p in joined
        ]
