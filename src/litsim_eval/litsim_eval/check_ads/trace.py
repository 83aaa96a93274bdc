"""Observations of a driving system during a run, the input of all clauses; independent of ROS."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from litsim_sim.core.topic_names import Interface
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.ego_port.answer import Answer
from litsim_sim.ego_port.tracking import EgoState
from litsim_sim.lane_map.lane_map import LaneMap

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
    """An answer, the time of its reception by this machine's clock [ns], and the newest step at that time."""

    answer: Answer
    received_ns: int
    newest: int

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


@dataclass(frozen=True)
class Evidence:
    """All observations of a stack in one run.

    Attributes:
        wait_s: longest time to wait for a publisher [s].
        discovered_s: seconds until a publisher of each interface was found, from the start of the stack on.
        endpoints: of the stack.
        published_ns: times at which each step was published [ns].
        heard: answers over all interfaces, in order of arrival.
        interface: in use by the bridge; None if no answer has reached it.
        counts: of the answers at the bridge, by :data:`litsim_sim.ego_port.port.COUNTS`.
        remarks: of the bridge on ``/diagnostics`` about the answers, by :func:`summarised`.
        states: of the ego, by step, from the record.
        history_steps: steps at the start of the run in which the ego follows its log, whatever is answered.
        lane_map: of the road.
        vehicle: model of the ego.
        total_steps: last step of the run, which begins at 0.
        state: last state of the run: FINISHED, FAILED, or empty if the bridge reported neither.
        failure: why the run failed; empty if it did not.
        left: step at which the stack left before the end of the run; None if it stayed.
        ending: behaviour after the end of the run.
        intrusions: texts on publishers on topics of the graph that are not for stacks.
        difference: how a second run with the same stack differs, empty if it does not; None if there was none.
    """

    wait_s: float
    discovered_s: dict[Interface, float]
    endpoints: tuple[Endpoint, ...]
    published_ns: dict[int, list[int]]
    heard: tuple[Heard, ...]
    interface: Interface | None
    counts: dict[str, int]
    remarks: tuple[str, ...]
    states: dict[int, EgoState]
    history_steps: int
    lane_map: LaneMap
    vehicle: VehicleModel
    total_steps: int
    state: str
    failure: str
    left: int | None
    ending: Ending = field(default_factory=lambda: Ending(0.0, None, present=False))
    intrusions: tuple[str, ...] = ()
    difference: str | None = None

    def driven(self, step: int) -> EgoState | None:
        """Returns the state of the ego at a step; None if it is unknown, or the answer does not drive the ego."""
        return self.states.get(step) if step >= self.history_steps else None

    @property
    def used(self) -> list[Heard]:
        """The answers over the interface in use, or over all interfaces if no answer has reached the bridge."""
        return [answer for answer in self.heard if self.interface in (None, answer.answer.interface)]

    @property
    def reachable(self) -> bool:
        """Whether a publisher of the stack matches the bridge."""
        return any(endpoint.publishes and not endpoint.problem for endpoint in self.endpoints)


def summarised(remarks: Iterable[str]) -> tuple[str, ...]:
    """Returns, of remarks that differ only in numbers, the last one, which holds their count."""
    return tuple({NUMBER.sub("#", text): text for text in remarks}.values())
