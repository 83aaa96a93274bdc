"""The careful and competent human driver model of UN Regulation 157: would it have avoided a contact?

The parameters are the regulation's: the driver perceives a risk once a vehicle in the next lane has wandered 0.375 m
from the centre of that lane towards it, or once the time to collision is 2 s; reacts after 0.75 s; and brakes at up to
0.774 g, reached with a jerk of 12.65 m/s3. The regulation's risk evaluation time of 0.4 s is omitted, which makes the
verdict stricter.

The driver reacts to the risk that leads to the contact: to none that was over before, and to no vehicle that another
one hides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_data.surrogates.safety import times_to_collision
from litsim_sim.core.geometry import boxes_overlap, to_body
from litsim_sim.core.scene import AgentRows, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_map import LaneMap

REACTION_S = 0.75
BRAKE_MAX = 0.774 * 9.81  # [m/s2]
BRAKE_JERK = 12.65  # [m/s3]
WANDERING = 0.375  # [m]
NEXT_LANE = 1.5  # lane widths from the centre of the agent's lane within which a vehicle drives next to that lane
TTC_S = 2.0
TINY_M = 1e-9
LOOK_BACK_S = 5.0  # time before the contact in which a risk is searched for
OVER_S = 0.5  # time without a risk after which that risk is over; our choice
LOOK_ON_S = 3.0  # time after the contact in which the driver must stay clear of the other vehicle


@dataclass(frozen=True)
class CarefulDriver:
    """Verdict on one contact.

    Attributes:
        perceived_step: step at which the driver perceives the risk; the contact step if nothing announces it.
        avoided: whether the driver avoids the contact by braking on the path that the replaced vehicle took.
    """

    perceived_step: int
    avoided: bool


def careful_driver(
    tables: Sequence[AgentTable],
    driven: int,
    agent: int,
    contact_step: int,
    dt: float,
    lane_map: LaneMap | None,
    *,
    sees_all: bool = False,
) -> CarefulDriver:
    """Replaces the driver of `driven` by the careful driver before its contact with `agent`.

    The regulation defines this for the vehicle under test; here it applies to background agents as well. The other
    vehicle moves as in the run, whatever the driver does. Where the run ends before the driver has stayed free for long
    enough, both vehicles go straight on at their last speeds.

    Args:
        tables: steps of the run, ascending.
        driven: id of the vehicle whose driver is replaced.
        agent: id of the other vehicle.
        contact_step: first step of the contact.
        dt: duration of a step [s].
        lane_map: lanes, for the wandering criterion; without them only the time to collision counts.
        sees_all: whether no third vehicle hides `agent`, as where recorded vehicles drive through each other.
    """
    whole = Steps.of(tables)
    since = (whole.step - contact_step) * dt
    begin, end = (int(np.argmax([*is_over, True])) for is_over in (since >= -LOOK_BACK_S, since > LOOK_ON_S))
    steps = whole.part(begin, end)
    rows = steps.rows_of(np.array([driven, agent]))
    near = rows.min(axis=1) >= 0
    own, other = rows[near].T
    step, table = steps.step[near], steps.stacked
    risk = risky(table, own, other, lane_map) & (step <= contact_step)
    risk &= sees_all | ~hidden(steps, own, other)
    perceived = _begin(step[risk], contact_step, round(OVER_S / dt))
    step, own, other = (values[step >= perceived] for values in (step, own, other))
    lacking = max(0, contact_step + round(LOOK_ON_S / dt) - int(whole.step[-1])) if near[-1] else 0
    beyond = np.append(np.zeros(len(step), np.int64), np.arange(1, lacking + 1))  # the last step of the run
    step, own, other = (np.append(values, np.repeat(values[-1:], lacking)) for values in (step, own, other))
    step = step + beyond
    (own_x, own_y), (other_x, other_y) = (_straight_on(table, rows, beyond, dt) for rows in (own, other))
    path = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(own_x), np.diff(own_y)))])
    s = _braked(table.speed[own].tolist(), path.tolist(), ((step - perceived) * dt).tolist())
    x, y, yaw = (np.interp(s, path, values) for values in (own_x, own_y, np.unwrap(table.yaw[own])))
    own_size, other_size = ((table.length[rows], table.width[rows]) for rows in (own, other))
    hits = boxes_overlap(other_x - x, other_y - y, yaw, table.yaw[other], own_size, other_size)
    return CarefulDriver(perceived, avoided=not hits.any())


def _begin(risks: IntArray, contact_step: int, over: int) -> int:
    """Returns the first of the steps of a risk (k,) that lasts to the contact, with gaps of up to `over` steps."""
    begin = contact_step
    for step in risks[::-1].tolist():
        if begin - step > over + 1:
            break
        begin = step
    return begin


def hidden(steps: Steps, own: IntArray, other: IntArray) -> BoolArray:
    """Returns (k,) whether a third vehicle stands or drives between the centres of `own` and `other`.

    Args:
        steps: of all agents.
        own, other: (k,) rows in `steps.stacked` of two agents at the same steps, each step once.
    """
    table, of_step = steps.stacked, np.full(len(steps), -1)
    of_step[table.number[own]] = np.arange(len(own))
    k = of_step[table.number]
    third = (k >= 0) & ~table.obstacle & ~np.isin(table.id, table.id[[*own[:1], *other[:1]]])
    rows, k = third.nonzero()[0], k[third]
    begin, end = (
        np.array(to_body(table.x[of[k]] - table.x[rows], table.y[of[k]] - table.y[rows], table.yaw[rows]))
        for of in (own, other)
    )
    way = end - begin
    way[np.abs(way) < TINY_M] = TINY_M
    half = 0.5 * np.array([table.length[rows], table.width[rows]])
    sides = np.sort([(-half - begin) / way, (half - begin) / way], axis=0)  # shares of the way, along and across
    enters, leaves = sides[0].max(axis=0, initial=0.0), sides[1].min(axis=0, initial=1.0)
    return np.bincount(k[enters < leaves], minlength=len(own)) > 0


def _straight_on(table: AgentRows, rows: IntArray, later: IntArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Returns where vehicles in `rows` (k,) are [m] `later` (k,) steps of `dt` [s] later, if they drive straight on."""
    way = table.speed[rows] * dt * later
    return table.x[rows] + way * np.cos(table.yaw[rows]), table.y[rows] + way * np.sin(table.yaw[rows])


def speed_lost(time: float) -> float:
    """Returns the speed [m/s] lost to braking `time` [s] after the risk is perceived, unless the driver comes to rest.

    0 during the reaction time; then the deceleration grows with BRAKE_JERK up to BRAKE_MAX, and stays there.
    """
    braked, build_up = max(time - REACTION_S, 0.0), BRAKE_MAX / BRAKE_JERK
    return 0.5 * BRAKE_JERK * min(braked, build_up) ** 2 + BRAKE_MAX * max(braked - build_up, 0.0)


def _braked(real: list[float], path: list[float], time: list[float]) -> list[float]:
    """Returns the driver's position [m] along the path of the replaced vehicle at each step.

    Args:
        real: speeds of the replaced vehicle [m/s].
        path: positions of the replaced vehicle along its path [m].
        time: time since the risk was perceived [s], ascending from 0.
    """
    s, speed = [0.0], [real[0]]
    for k in range(1, len(real)):
        lost = speed_lost(time[k]) - speed_lost(time[k - 1])
        most = real[k] if time[k] <= REACTION_S else speed[-1]
        speed.append(max(0.0, min(speed[-1] - lost, most)))
        way = 0.5 * (speed[-2] + speed[-1]) * (time[k] - time[k - 1])
        s.append(min(s[-1] + way, path[k]))  # never ahead of the replaced vehicle
    return s


def risky(table: AgentRows, own: IntArray, other: IntArray, lane_map: LaneMap | None) -> BoolArray:
    """Returns (k,) whether the careful driver of `own` perceives `other` as a risk; both (k,) are rows of `table`."""
    pairs = table.take(np.sort([own, other], axis=0).ravel("F"))
    e, a = 2 * np.arange(len(own)) + [own > other, own < other]
    risky = times_to_collision(pairs, e) <= TTC_S
    if lane_map is None:
        return risky
    nearest = lane_map.nearest(pairs.x, pairs.y, pairs.yaw)
    _, left = to_body(pairs.x[e] - pairs.x[a], pairs.y[e] - pairs.y[a], nearest.heading[a])
    towards = np.sign(left) * nearest.d[a]
    across = np.abs(left + nearest.d[a])  # distance from the centre of the other vehicle's lane [m]
    width = lane_map.widths[nearest.lane[a]]
    return risky | ((nearest.lane[e] != nearest.lane[a]) & (towards > WANDERING) & (across < NEXT_LANE * width))
