"""Closed stop lines, as networks see them: as vehicles that stand there for as long as signals forbid to pass.

So signals need no inputs of their own: a network that knows how people drive up to a vehicle that stands, and wait
behind it, learns the rest from traffic at signals.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from litsim_predictor.inference.contract import HISTORY, HISTORY_CHANNELS, STRIDE
from litsim_predictor.inference.joint.units import TRAFFIC_AGO, TRAFFIC_KNOTS
from litsim_predictor.inference.traffic import Traffic
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.core.signals import AMBER_STATES, STOP_STATES
from litsim_sim.lane_map.signal_links import by_lane
from litsim_sim.scenario.signals import LinkSignals

IS_CLOSED = np.isin(np.arange(256), (*STOP_STATES, *AMBER_STATES))
"""Mask by state: whoever can still stop does so."""
LENGTH, WIDTH = 0.0, 2.0
"""[m] of what stands on a closed line; vehicles have lengths."""


class Vehicles(NamedTuple):
    """What networks read of n vehicles, or of what counts as such.

    Attributes:
        series: (n, HISTORY, HISTORY_CHANNELS) x, y [m], yaw [rad], speed [m/s] in frame map, oldest first.
        observed: (n, HISTORY).
        size: (n, 2) length, width [m].
        heading: (n,) of the agent frames [rad].
        scene: (n,).
    """

    series: FloatArray
    observed: BoolArray
    size: FloatArray
    heading: FloatArray
    scene: IntArray

    def beside(self, others: Vehicles) -> tuple[Self, IntArray]:
        """Returns these and `others`, by scene, of each scene these first; and the rows (n,) in which these are."""
        order = np.concatenate([self.scene, others.scene]).argsort(kind="stable")
        rows = np.empty(len(order), np.int64)
        rows[order] = np.arange(len(order))
        both = (np.concatenate(pair)[order] for pair in zip(self, others, strict=True))
        return type(self)(*both), rows[: len(self.scene)]


class ClosedLines:
    """The stop lines of the lanes of which signals control every connection.

    Attributes:
        pose: (lines, 3) x, y [m] of their middles, and heading [rad] of their lanes, frame map.
    """

    def __init__(self, signals: LinkSignals) -> None:
        self._signals = signals
        lanes = by_lane(signals.links)
        self._links = np.concatenate(lanes)
        self._first = np.cumsum([0, *map(len, lanes)])[:-1]
        links = [signals.links[places[0]] for places in lanes]
        self.pose: FloatArray = np.array([[*link.stop, link.heading] for link in links])

    def closed(self, step: int) -> BoolArray:
        """Returns the mask (scenes, lines) of lines whose connections are all closed at `step`."""
        closed: BoolArray = IS_CLOSED[self._signals.of_links(step)[:, self._links]]
        return np.asarray(np.logical_and.reduceat(closed, self._first, axis=1))

    def near(self, agents: AgentTable) -> Vehicles:
        """Returns the lines that are closed at the step of `agents`, within the reach of features of one of them."""
        scene, line = self.closed(agents.step).nonzero()
        away = np.hypot(agents.x[:, None] - self.pose[line, 0], agents.y[:, None] - self.pose[line, 1])
        near = ((away < TRAFFIC_KNOTS[-1]) & (agents.scene[:, None] == scene)).any(axis=0)
        scene, line = scene[near], line[near]
        observed = np.zeros((len(line), HISTORY), np.bool_)
        for back in range(min(HISTORY, agents.step // STRIDE + 1)):
            observed[:, -1 - back] = self.closed(agents.step - STRIDE * back)[scene, line]
        series = np.zeros((len(line), HISTORY, HISTORY_CHANNELS))
        series[..., :3] = self.pose[line, None]
        return Vehicles(series, observed, np.full((len(line), 2), (LENGTH, WIDTH)), self.pose[line, 2], scene)


def among_traffic(traffic: Traffic, lines: Vehicles) -> Traffic:
    """Returns `traffic` with closed `lines` among it, of each scene behind the vehicles."""
    order = np.concatenate([traffic.scene, lines.scene]).argsort(kind="stable")
    still = np.zeros(len(lines.scene), np.float32)
    return Traffic(
        pose=np.concatenate([traffic.pose, lines.series[:, -1, :3]])[order],
        speed=np.concatenate([traffic.speed, still])[order],
        earlier=np.concatenate([traffic.earlier, still])[order],
        seen=np.concatenate([traffic.seen, lines.observed[:, -1 - TRAFFIC_AGO]])[order],
        scene=np.concatenate([traffic.scene, lines.scene])[order],
    )
