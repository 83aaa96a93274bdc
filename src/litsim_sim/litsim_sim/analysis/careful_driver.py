"""The careful and competent human driver of UN Regulation 157: would he have avoided a contact, in either place?

The regulation gives the driver's numbers: he sees the risk once a vehicle of the next lane has wandered 0.375 m from
its centre towards him, or once the time to collision is 2 s; reacts after 0.75 s; and brakes up to 0.774 g, building it
up with 12.65 m/s3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.analysis.safety import times_to_collision
from litsim_sim.core.geometry import boxes_overlap, to_body
from litsim_sim.core.scene import AgentTable
from litsim_sim.maps.lane_map import LaneMap

REACTION_S = 0.75
BRAKE_MAX = 0.774 * 9.81  # [m/s2]
BRAKE_JERK = 12.65  # [m/s3]
WANDERING = 0.375  # [m]
NEXT_LANE = 1.5  # widths of the agent's lane, from its centre: whoever is nearer drives beside it
TTC_S = 2.0
LOOK_BACK_S = 5.0  # before the contact, from which on a risk is looked for
LOOK_ON_S = 3.0  # after it, in which the driver must stay free


@dataclass(frozen=True)
class CarefulDriver:
    """Verdict on one contact.

    Attributes:
        agent: whom the driver would have to stay free of.
        contact_step: of the real contact.
        perceived_step: at which the driver sees the risk; the contact step where nothing announces it.
        avoided: whether he stays free of the agent, braking on the path that his vehicle took.
        speed_at_contact: the driver's speed where he does not [m/s]; 0 where he does.
    """

    agent: int
    contact_step: int
    perceived_step: int
    avoided: bool
    speed_at_contact: float


def careful_driver(
    tables: Sequence[AgentTable], driven: int, agent: int, contact_step: int, dt: float, lane_map: LaneMap | None
) -> CarefulDriver:
    """Put the driver into the seat of `driven` before its contact with `agent`.

    The regulation asks this of the vehicle under test; of a background agent it is asked in the same way. The other
    vehicle keeps to what it did in the run, whatever the driver does.

    Args:
        tables: steps of the run, ascending.
        driven: id of the vehicle that the driver takes the seat of.
        agent: id of the other one.
        contact_step: first step of contact.
        dt: of a step [s].
        lane_map: for the wandering; without it only the time to collision counts.
    """
    window = [t for t in tables if abs(t.step - contact_step) * dt <= max(LOOK_BACK_S, LOOK_ON_S)]
    window = [t for t in window if t.step <= contact_step + LOOK_ON_S / dt and t.row(driven) >= 0 and t.row(agent) >= 0]
    perceived = next(
        (t.step for t in window if t.step <= contact_step and _risky(t, driven, agent, lane_map)), contact_step
    )
    ahead = [t for t in window if t.step >= perceived]
    rows = [t.row(driven) for t in ahead]
    x, y, yaw = (np.array([getattr(t, f)[r] for t, r in zip(ahead, rows, strict=True)]) for f in ("x", "y", "yaw"))
    path = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    real = np.array([t.speed[r] for t, r in zip(ahead, rows, strict=True)])
    s, speed, brake = 0.0, float(real[0]), 0.0
    for k, table in enumerate(ahead):
        if k > 0:
            if (table.step - perceived) * dt > REACTION_S:
                brake = min(BRAKE_MAX, brake + BRAKE_JERK * dt)
            before, speed = speed, max(0.0, min(speed - brake * dt, float(real[k]) if brake == 0.0 else speed))
            s += 0.5 * (before + speed) * dt
        s = min(s, float(path[k]))  # he is never ahead of where the vehicle was
        at = [float(np.interp(s, path, values)) for values in (x, y, np.unwrap(yaw))]
        if _meets(table, driven, agent, at):
            return CarefulDriver(agent, contact_step, perceived, avoided=False, speed_at_contact=speed)
    return CarefulDriver(agent, contact_step, perceived, avoided=True, speed_at_contact=0.0)


def _risky(table: AgentTable, driven: int, agent: int, lane_map: LaneMap | None) -> bool:
    """Whether the driver sees that `agent` is a risk."""
    pair = table.take(np.isin(table.id, [driven, agent]))
    e, a = pair.row(driven), pair.row(agent)
    if times_to_collision(pair, np.array([e]))[0] <= TTC_S:
        return True
    if lane_map is None:
        return False
    at = lane_map.nearest(pair.x, pair.y, pair.yaw)
    if at.lane[e] == at.lane[a]:
        return False
    _, left = to_body(pair.x[e : e + 1] - pair.x[a], pair.y[e : e + 1] - pair.y[a], at.heading[a : a + 1])
    towards = float(np.sign(left[0]) * at.d[a])
    to_driven = abs(float(left[0] + at.d[a]))  # across, from the centre of the agent's lane
    return towards > WANDERING and to_driven < NEXT_LANE * lane_map.lanes[at.lane[a]].width


def _meets(table: AgentTable, driven: int, agent: int, pose: list[float]) -> bool:
    """Whether the box of `driven` at `pose` (x, y, yaw) overlaps the agent's."""
    e, a = table.row(driven), table.row(agent)
    hit = boxes_overlap(
        np.array([table.x[a] - pose[0]]),
        np.array([table.y[a] - pose[1]]),
        np.array([pose[2]]),
        table.yaw[a : a + 1],
        (table.length[e : e + 1], table.width[e : e + 1]),
        (table.length[a : a + 1], table.width[a : a + 1]),
    )
    return bool(hit[0])
