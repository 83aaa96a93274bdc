"""Observations of a driving system during a run, the input of all clauses; independent of ROS."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from litsim_sim.core.topic_names import Interface
from litsim_sim.ego_port.answer import Answer
from litsim_sim.ego_port.tracking import EgoState
from litsim_sim.scenario.scenario import Scenario

NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?|\bnan\b|\binf\b")  # ignored when remarks are compared
FINISHED, FAILED = "FINISHED", "FAILED"


@dataclass(frozen=True)
class Endpoint:
    """A publisher or a subscription of the stack, on a topic of the ego port.

    Attributes:
        topic: its name.
        node: full name of its node.
        publishes: whether it is a publisher; otherwise a subscription.
        problem: why it does not match the bridge's endpoint, with both sides; empty if it does.
    """

    topic: str
    node: str
    publishes: bool
    problem: str = ""


@dataclass(frozen=True)
class Heard:
    """An answer, and the time of its reception by this machine's clock [ns]."""

    answer: Answer
    received_ns: int

    @property
    def step(self) -> int:
        """The step that it answers, or that nearest to its stamp."""
        return self.answer.nearest_step


@dataclass(frozen=True)
class Ending:
    """Behaviour of the stack after the end of the run.

    Attributes:
        watched_s: time for which it was watched [s].
        last_s: time of its last message since the end of the run [s]; None if there was none.
        present: whether it still had a publisher at the end of the watch.
        exit_status: of its process, negative for a signal; None if it still runs or was started elsewhere.
        obituary: how its process ended, in words; empty if it still runs or was started elsewhere.
    """

    watched_s: float
    last_s: float | None
    present: bool
    exit_status: int | None = None
    obituary: str = ""


@dataclass
class Evidence:
    """All observations of a stack in one run, as they are made.

    Attributes:
        scenario: of the run; in its history the ego follows its log, whatever is answered.
        wait_s: longest time to wait for a publisher [s].
        discovered_s: seconds until a publisher of each interface was found, from the start of the stack on.
        endpoints: of the stack, sorted by topic.
        published_ns: times at which the bridge published each step, by this machine's clock [ns].
        heard: answers over all interfaces, in order of arrival.
        interface: in use by the bridge; None if no answer has reached it.
        counts: of the answers at the bridge, by :data:`litsim_sim.ego_port.port.COUNTS`.
        states: of the ego, by step, from the record.
        state: last state of the run: FINISHED, FAILED, or empty if the bridge reported neither.
        failure: why the run failed; empty if it did not.
        left: step at which the stack left before the end of the run; None if it stayed.
        ending: behaviour after the end of the run.
        intrusions: texts on publishers on topics of the graph that are not for stacks.
        difference: how a second run with the same stack differs, empty if it does not; None if there was none.
    """

    scenario: Scenario
    wait_s: float
    discovered_s: dict[Interface, float] = field(default_factory=dict)
    endpoints: tuple[Endpoint, ...] = ()
    published_ns: dict[int, list[int]] = field(default_factory=dict)
    heard: list[Heard] = field(default_factory=list)
    interface: Interface | None = None
    counts: dict[str, int] = field(default_factory=dict)
    states: dict[int, EgoState] = field(default_factory=dict)
    state: str = ""
    failure: str = ""
    left: int | None = None
    ending: Ending = field(default_factory=lambda: Ending(0.0, None, present=False))
    intrusions: list[str] = field(default_factory=list)
    difference: str | None = None
    _remarks: dict[str, str] = field(default_factory=dict)

    def remark(self, text: str) -> None:
        """Notes what the bridge says about the answers on ``/diagnostics``."""
        self._remarks[NUMBER.sub("#", text)] = text

    @property
    def remarks(self) -> list[str]:
        """What the bridge has said; of remarks that differ only in numbers the last one, which holds their count."""
        return list(self._remarks.values())

    @property
    def newest(self) -> int:
        """The newest step that was published; 0 before the first."""
        return max(self.published_ns, default=0)

    @property
    def over(self) -> bool:
        """Whether the bridge has reported the end of the run."""
        return self.state in (FINISHED, FAILED)

    def driven(self, step: int) -> EgoState | None:
        """Returns the state of the ego at a step; None if it is unknown, or the answer does not drive the ego."""
        return self.states.get(step) if step >= self.scenario.history_steps else None

    @property
    def used(self) -> list[Heard]:
        """The answers over the interface in use, or over all interfaces if no answer has reached the bridge."""
        return [answer for answer in self.heard if self.interface in (None, answer.answer.interface)]

    @property
    def reachable(self) -> bool:
        """Whether a publisher of the stack matches the bridge."""
        return any(endpoint.publishes and not endpoint.problem for endpoint in self.endpoints)
