"""A proposal of traffic lights from how vehicles drive: who stops at a stop line, and who starts there, and when.

Behind a light, the first in a lane stands from red on, and starts soon after green; between the last that passes and
the next that starts, nobody does. All of this repeats with the cycle of the light. So the cycle of a junction is that
with which the starts of the first in its lanes agree best; lanes that are green at the same time of it are a group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.lane_map.signal_links import SignalLink, by_lane, crossings
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.signals import SignalsFile

FIRST_M = 7.0  # [m] before the stop line, within which there is room for the first in a lane alone
BEYOND_M = 1.5  # [m] beyond it, where some stop all the same
STANDS, STOOD_S = 0.5, 2.0  # speed [m/s] below which a vehicle stands, and for how long [s] it does if it is stopped
START_S = 1.0  # [s] from green until the first in a lane moves
AMBER_S = 3.0  # [s] before red: who cannot stop passes, in the first half of it for the most part
CYCLES_S = (25.0, 180.0)  # [s] of lights in use
CYCLE_STEP_S, NEAR = 0.1, 30
AGREE = 0.95  # length of the mean vector of starts, as angles of the cycle, from which on they agree
SAME_S = 4.0  # [s] by which times of green of lanes of a group differ at most
OUTSIDE = 0.1  # share of the passages of a lane that joins a group, at its red


@dataclass(frozen=True)
class Lane:
    """What vehicles do at a stop line, at times from step 0 on.

    Attributes:
        links: connections from the lane.
        stands: (n, 2) from when until when the first in the lane stood [s].
        starts: (m,) when those of them started that passed [s].
        passes: (k,) passages [s].
    """

    links: tuple[SignalLink, ...]
    stands: FloatArray
    starts: FloatArray
    passes: FloatArray

    @property
    def name(self) -> str:
        """Id of the lane."""
        return self.links[0].from_lane


@dataclass(frozen=True)
class Group:
    """Connections that are green together.

    Attributes:
        name: of the group.
        lanes: from which they lead, those with times of green of their own first.
        links: the connections.
        cycle_s: length of the cycle [s].
        green_s, red_s: when it turns green, from step 0 on, first at 0 s or later; and how long after that red [s].
        permissive: whether they give way to others that are green.
    """

    name: str
    lanes: tuple[Lane, ...]
    links: tuple[SignalLink, ...]
    cycle_s: float
    green_s: float
    red_s: float
    permissive: bool

    def changes(self, until_s: float) -> list[tuple[float, str, str]]:
        """Returns what it shows until then [s], as :class:`litsim_sim.scenario.signals.SignalsFile` has it."""
        shown: list[tuple[float, str, str]] = []
        for begin in np.arange(self.green_s - self.cycle_s, until_s, self.cycle_s):
            green = "green_permissive" if self.permissive else "green"
            changes = (begin, green), (begin + self.red_s - AMBER_S, "amber"), (begin + self.red_s, "red")
            shown += [(round(time, 1), self.name, state) for time, state in changes]
        return [change for change in shown if change[0] < until_s]

    def line(self) -> str:
        """Returns when it is green, and on which connections."""
        times = f"green at {self.green_s:.1f} s, red {self.red_s:.1f} s later, again every {self.cycle_s:.1f} s"
        return f"group {self.name}: {times}: {', '.join(link.name for link in self.links)}"


@dataclass(frozen=True)
class Proposal:
    """What is proposed.

    Attributes:
        groups: of signals.
        unsure: lanes of the same junctions that are left without a light: few pass, or some of them at any time.
        duration_s: of the recording [s].
    """

    groups: tuple[Group, ...]
    unsure: tuple[Lane, ...]
    duration_s: float

    @property
    def file(self) -> SignalsFile:
        """The proposal as a file of signals."""
        changes = [change for group in self.groups for change in group.changes(self.duration_s)]
        names = {group.name: [link.name for link in group.links] for group in self.groups}
        return SignalsFile(groups=names, changes=sorted(changes))


def propose_lights(links: Sequence[SignalLink], log: Log) -> Proposal:
    """Returns lights on some of `links`, all connections of a net, by the `log` of a recording from frame 0 on.

    Raises:
        InputError: at no junction starts repeat.
    """
    by_junction: dict[str, list[Lane]] = {}
    for lane in _lanes([link for link in links if link.foes], log):
        by_junction.setdefault(lane.links[0].junction, []).append(lane)
    groups, unsure = list[Group](), list[Lane]()
    for junction, lanes in by_junction.items():
        cycle = _cycle(lanes)
        if cycle is not None:
            found, left = _groups(junction, lanes, cycle)
            groups += found
            unsure += left
    if not groups:
        raise InputError(
            "the recording shows no traffic light: at no junction the first vehicles of most lanes start again and "
            f"again after equal times; expected at least two cycles of {CYCLES_S[0]:g} to {CYCLES_S[1]:g} s"
        )
    return Proposal(tuple(groups), tuple(unsure), log.valid.shape[1] * STEP_S)


def _lanes(links: Sequence[SignalLink], log: Log) -> list[Lane]:
    """Returns what vehicles do where the lanes of `links` end."""
    driven = log.valid & ~log.obstacle[:, None]
    passages = crossings(links, log.x, log.y, log.yaw, log.length, driven)
    half = 0.5 * log.length[:, None]
    front_x, front_y = log.x + half * np.cos(log.yaw), log.y + half * np.sin(log.yaw)
    lanes = []
    for places in by_lane(links):
        line = links[places[0]]
        cos, sin = np.cos(line.heading), np.sin(line.heading)
        dx, dy = front_x - line.stop[0], front_y - line.stop[1]
        along, beside = cos * dx + sin * dy, cos * dy - sin * dx
        first = driven & (along > -FIRST_M) & (along < BEYOND_M) & (np.abs(beside) < 0.5 * line.width)
        stands, starts = [], []
        here = np.isin(passages.link, places)
        passed = dict(zip(passages.agent[here].tolist(), passages.step[here].tolist(), strict=True))
        for agent in np.flatnonzero((first & (log.speed < STANDS)).any(axis=1)):
            still = np.flatnonzero(first[agent] & (log.speed[agent] < STANDS))
            begin, end = still[0], still[-1] + 1
            if (end - begin) * STEP_S >= STOOD_S:
                stands.append((begin, end))
                starts += [end] * (agent in passed)
        own = tuple(links[place] for place in places)
        in_steps = stands, sorted(starts), sorted(passed.values())
        stood, started, passes = (np.array(steps, np.float64) * STEP_S for steps in in_steps)
        lanes.append(Lane(own, stood.reshape(-1, 2), started, passes))
    return lanes


def _agreement(times: FloatArray, cycle: FloatArray | float) -> FloatArray:
    """Returns how well `times` (n,) [s] agree in each `cycle` (c,) [s]: 1 if all are at the same time of it."""
    angle = 2.0 * np.pi * times / np.asarray(cycle)[..., None]
    return np.asarray(np.hypot(np.cos(angle).mean(axis=-1), np.sin(angle).mean(axis=-1)))


def _cycle(lanes: Sequence[Lane]) -> float | None:
    """Returns the cycle [s] of the light of a junction; None if starts do not repeat in at least two lanes.

    In parts of it starts agree as well, but some pass when others stood.
    """
    starts = [lane.starts for lane in lanes if len(lane.starts) > 1]
    if len(starts) < 2:
        return None
    cycles = np.arange(*CYCLES_S, CYCLE_STEP_S)
    agreement = np.array([_agreement(times, cycles) for times in starts])
    agree = np.average(agreement, axis=0, weights=[len(times) - 1.0 for times in starts])
    against = np.sum([_passes_while_standing(lane, cycles) for lane in lanes], axis=0)
    cost = 1.0 - agree + against / sum(len(lane.passes) for lane in lanes)
    best = int(np.argmin(cost))
    repeat = agreement[:, best] >= AGREE
    if repeat.sum() < 2:
        return None
    near = slice(max(best - NEAR, 0), best + NEAR + 1)  # those who give way at green are late, and count no longer
    return float(cycles[near][agreement[repeat, near].sum(axis=0).argmax()])


def _passes_while_standing(lane: Lane, cycles: FloatArray) -> FloatArray:
    """Returns how many pass at times of each cycle (c,) [s] at which somebody stood in the lane in another one."""
    if not len(lane.stands):
        return np.zeros(len(cycles))
    begin, end = lane.stands.T
    since = (lane.passes[:, None] - begin) % cycles[:, None, None]  # (c, passes, stands)
    stood = since < np.maximum(end - begin - START_S, 0.0)
    return np.asarray(stood.any(axis=2).sum(axis=1), np.float64)


@dataclass
class _Green:
    """Lanes that are green together: from `begin` in the cycle on, until `end` after that [s]."""

    lanes: list[Lane]
    begin: float
    end: float


def _groups(junction: str, lanes: Sequence[Lane], cycle: float) -> tuple[list[Group], list[Lane]]:
    """Returns the groups of a junction with a light of this `cycle` [s], and the lanes that are in none."""
    greens, others = list[_Green](), list[Lane]()
    for lane in sorted(lanes, key=lambda lane: (-len(lane.starts), -len(lane.passes))):
        if not len(lane.starts) or _agreement(lane.starts, cycle) < AGREE:
            others.append(lane)
            continue
        if len(lane.starts) == 1 and _joined(lane, greens, cycle):
            continue
        own = _own_green(lane, cycle)
        alike = next((green for green in greens if _same(green, own, lane, cycle)), None)
        if alike is None:
            greens.append(own)
        else:
            alike.lanes.append(lane)
            alike.end = max(alike.end, own.end)
    unsure = [lane for lane in others if not _joined(lane, greens, cycle)]
    groups = []
    for number, green in enumerate(sorted(greens, key=lambda green: green.begin)):
        links = [link for lane in green.lanes for link in lane.links]
        straight = {link.name for link in links if not link.turns}
        for permissive, name in ((False, f"{junction} {number + 1}"), (True, f"{junction} {number + 1} turning")):
            those = tuple(link for link in links if permissive == (link.turns and bool(straight & set(link.foes))))
            if those:
                groups.append(
                    Group(name, tuple(green.lanes), those, cycle, green.begin, green.end + 0.5 * AMBER_S, permissive)
                )
    return groups, unsure


def _own_green(lane: Lane, cycle: float) -> _Green:
    """Returns when a lane is green in the cycle: from its starts on, until nobody passes for most of the cycle."""
    angle = 2.0 * np.pi * lane.starts / cycle
    mean = np.arctan2(np.sin(angle).mean(), np.cos(angle).mean()) / (2.0 * np.pi) * cycle
    begin = float((mean - START_S) % cycle)
    passes = np.sort((lane.passes - begin) % cycle)
    after = np.diff(passes, append=passes[0] + cycle)
    return _Green([lane], begin, float(passes[np.argmax(after)]))


def _same(green: _Green, own: _Green, lane: Lane, cycle: float) -> bool:
    """Whether a lane that is green by itself as `own` says is so with those of `green`: nobody stops in it before."""
    if abs((own.begin - green.begin + 0.5 * cycle) % cycle - 0.5 * cycle) > SAME_S:
        return False
    stops = (lane.stands[:, 0] - own.begin) % cycle
    first, last = sorted((own.end, green.end))
    return last - first <= SAME_S or not ((stops > first) & (stops < last - SAME_S)).any()


def _joined(lane: Lane, greens: Sequence[_Green], cycle: float) -> bool:
    """Puts a lane without a time of its own to the lanes of its edge, if it is passed when these are green; or not."""
    edge = lane.name.rpartition("_")[0]
    for green in greens:
        if len(lane.passes) and any(other.name.rpartition("_")[0] == edge for other in green.lanes):
            late = (lane.passes - green.begin) % cycle > green.end + START_S
            if late.mean() <= OUTSIDE:
                green.lanes.append(lane)
                return True
    return False
