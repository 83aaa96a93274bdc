"""Fit of the offset of a timing plan to recorded vehicles, for recordings with signals known only by their plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import STEP_S, BoolArray
from litsim_sim.core.signals import STOP_STATES
from litsim_sim.lane_map.signal_links import SignalLink
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.signals import Signals, SignalsFile, count_passages, signals_of

TRIED_S = 0.5  # [s] step of the search over offsets
START_S = 3.0  # [s] time of green after which the first vehicle at a stop line has begun to move
FIRST = 5.0  # [m] distance from the stop line, either way, within which a vehicle is first at it
STANDS = 0.4  # [m/s] speed below which a vehicle stands


@dataclass(frozen=True)
class OffsetFit:
    """An offset of a plan, and how well it fits.

    Attributes:
        offset_s: start of the first phase, from step 0 of the log [s].
        passed, at_red: numbers of vehicles that pass the stop lines, in total and at red, by group.
        waits_s: total time that vehicles stand at lines that have been open for START_S [s].
        range_s: first and last offset of the range that fits equally well [s]; it may wrap around the cycle.
    """

    offset_s: float
    passed: dict[str, int]
    at_red: dict[str, int]
    waits_s: float
    range_s: tuple[float, float]


def fit_offset(plan: SignalsFile, links: Sequence[SignalLink], log: Log) -> OffsetFit:
    """Returns the offset with the fewest passages at red and, among ties, the shortest waits at open lines.

    Of a range of equally good offsets the middle is taken; of several ranges, the first.

    Args:
        plan: signals with a program; its offset is ignored.
        links: controlled connections of the net.
        log: log from frame 0 of the recording on.

    Raises:
        InputError: the plan does not fit the net.
    """
    assert plan.program is not None, "only a program has an offset"
    cycle = sum(phase.duration_s for phase in plan.program.phases)
    offsets = np.arange(0.0, cycle, TRIED_S)
    costs = [_cost(_at(plan, float(offset), links, log), log) for offset in offsets]
    good = [cost == min(costs) for cost in costs]
    begin = good.index(False) if not all(good) else 0  # ranges may wrap around the cycle
    best = begin + np.flatnonzero(np.roll(good, -begin))
    first = offsets[np.split(best, np.flatnonzero(np.diff(best) > 1) + 1)[0] % len(offsets)]
    offset = float(first[len(first) // 2])
    heeded = count_passages(_at(plan, offset, links, log), log)
    return OffsetFit(
        offset,
        {group: passed for group, (passed, _) in heeded.items()},
        {group: red for group, (_, red) in heeded.items()},
        min(costs)[1] * STEP_S,
        (float(first[0]), float(first[-1])),
    )


def _at(plan: SignalsFile, offset: float, links: Sequence[SignalLink], log: Log) -> Signals:
    assert plan.program is not None
    moved = plan.model_copy(update={"program": plan.program.model_copy(update={"offset_s": offset})})
    return signals_of(moved, links, log.steps)


def _cost(signals: Signals, log: Log) -> tuple[int, int]:
    """Returns numbers of passages at red, and of steps that vehicles stand first at a line that has long been open."""
    waiting = 0
    front_x = log.x + 0.5 * log.length[:, None] * np.cos(log.yaw)
    front_y = log.y + 0.5 * log.length[:, None] * np.sin(log.yaw)
    needed = round(START_S / STEP_S)
    lanes = {link.from_lane: (link, group) for link, group in zip(signals.links, signals.link_group, strict=True)}
    for link, group in lanes.values():
        is_open = ~np.isin(signals.states[group], STOP_STATES)
        long_open: BoolArray = np.convolve(is_open, np.ones(needed))[: len(is_open)] >= needed
        cos, sin = np.cos(link.heading), np.sin(link.heading)
        dx, dy = front_x - link.stop[0], front_y - link.stop[1]
        first = (np.abs(cos * dx + sin * dy) < FIRST) & (np.abs(cos * dy - sin * dx) < 0.5 * link.width)
        waiting += int((first & log.valid & (log.speed < STANDS) & long_open).sum())
    return sum(red for _, red in count_passages(signals, log).values()), waiting
