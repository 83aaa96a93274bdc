"""What was seen of a driving system while it drove the ego of a run: the input of every clause, without ROS."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from litsim_sim.core.scene import STEP_NS
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.ego_port.answer import Answer, Interface
from litsim_sim.ego_port.tracking import EgoState
from litsim_sim.maps.lane_map import LaneMap

NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?|\bnan\b|\binf\b")  # by which remarks on the same thing differ
FINISHED, FAILED = "FINISHED", "FAILED"


@dataclass(frozen=True)
class Endpoint:
    """A publisher or a subscription of the stack, on a topic of the ego port.

    Attributes:
        topic: its name.
        node: full name of the node that it belongs to.
        publishes: a publisher, else a subscription.
        problem: why it does not match the bridge's end, with both sides named; empty where it does.
    """

    topic: str
    node: str
    publishes: bool
    problem: str = ""


@dataclass(frozen=True)
class Heard:
    """An answer, when it was received [ns of this machine's clock], and the step that was the newest then."""

    answer: Answer
    received_ns: int
    newest: int

    @property
    def step(self) -> int:
        """The step that it answers."""
        step = self.answer.step
        return round(self.answer.stamp_ns / STEP_NS) if step is None else step


@dataclass(frozen=True)
class Ending:
    """What the stack did once the run was over.

    Attributes:
        watched_s: how long it was watched [s].
        last_s: when it published last, since the end of the run [s]; None for never.
        present: whether one of its publishers was there at last.
        exit_status: of its process, negative for a signal; None while it runs, or where it was started by others.
        obituary: how its process ended, in words; empty where it runs, or was started by others.
    """

    watched_s: float
    last_s: float | None
    present: bool
    exit_status: int | None = None
    obituary: str = ""


@dataclass(frozen=True)
class Evidence:
    """Everything that was seen of a stack in one run.

    Attributes:
        wait_s: for which a publisher was waited for.
        found: seconds until a publisher of each interface was found, from when the stack could have been there.
        endpoints: of the stack.
        asked: when each step was published, once or more often [ns].
        heard: answers in the order in which they came, over whatever interface.
        interface: in use by the bridge; None where nothing has reached it.
        counts: what became of the answers at the bridge, :data:`litsim_sim.ego_port.port.COUNTS`.
        remarks: what the bridge said about them on ``/diagnostics``, as :func:`summarised`.
        states: of the ego, by step, from the record.
        lane_map: the road.
        vehicle: the ego's.
        total_steps: of the run, numbered 0 to this.
        state: of the run at last: FINISHED, FAILED, or empty where the bridge could not say.
        failure: why the run failed; empty where it did not.
        left: step at which the stack left before the run was over; None where it stayed.
        ending: what came then.
    """

    wait_s: float
    found: dict[Interface, float]
    endpoints: tuple[Endpoint, ...]
    asked: dict[int, list[int]]
    heard: tuple[Heard, ...]
    interface: Interface | None
    counts: dict[str, int]
    remarks: tuple[str, ...]
    states: dict[int, EgoState]
    lane_map: LaneMap
    vehicle: VehicleModel
    total_steps: int
    state: str
    failure: str
    left: int | None
    ending: Ending = field(default_factory=lambda: Ending(0.0, None, present=False))

    @property
    def used(self) -> list[Heard]:
        """The answers over the interface in use; over any where the bridge has heard none."""
        return [each for each in self.heard if self.interface in (None, each.answer.interface)]

    @property
    def reachable(self) -> bool:
        """Whether the bridge can hear the stack."""
        return any(each.publishes and not each.problem for each in self.endpoints)


def summarised(remarks: Iterable[str]) -> tuple[str, ...]:
    """Of remarks that differ in nothing but numbers the last, which holds their count, in the order of the first."""
    return tuple({NUMBER.sub("#", text): text for text in remarks}.values())
