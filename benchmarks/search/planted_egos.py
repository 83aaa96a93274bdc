"""The ego of `examples/minimal_ads.py` in process, with a weakness planted in it, or as a careful driver."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Literal

import numpy as np

from litsim_eval.analysis.careful_driver import risky, speed_lost
from litsim_policy.ego.ego import Ego
from litsim_sim.core.geometry import arc_lengths, to_body, wrap_angle
from litsim_sim.core.quantities import configuration
from litsim_sim.core.scene import ARRAY_FIELDS, STEP_S, AgentTable, BoolArray, EgoCommand, FloatArray, IntArray
from litsim_sim.core.signals import SignalState
from litsim_sim.ego_port.port import ego_state
from litsim_sim.ego_port.tracking import TwistTarget, follow_twist
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

RED = (SignalState.RED, SignalState.RED_AMBER, SignalState.AMBER)
LANE_M = 1.8  # [m] to the side up to which agents are in the way
CROSSING_M = 5.5  # [m] the same of agents that stand or drive across, for the careful driver
RISKS_M = 40.0  # [m] within which the careful driver looks for risks
CALM_STEPS = 10  # steps after a risk for which it goes on braking
BLIND_STEPS = 25  # steps for which one that comes from the side remains unknown
DELAY_STEPS = {"delay": 4, "late": 6}
BRAKES_MPS2, SOFT_MPS = {"soft": 1.0, "weak": 2.0}, 5.0  # hardest braking; below which speed, for `soft`
HEADWAY_S, CLOSE_S = 1.5, 0.3
NEAR_M = 20.0
BRAKES_FROM_MPS2, SHORT_M = 1.5, 0.2  # braking at which the careful driver begins to stop at a line; least way there
STANDS_MPS = 0.5
ACROSS = 0.5  # sine of the angle to the ego from which on others drive across
GROUP_ENDS_IN = "2"


Weakness = Literal[
    "none", "delay", "late", "soft", "weak", "close", "near", "side", "ramp", "standing", "walkers", "crossing", "red",
    "amber"
]  # fmt: skip


@configuration
class PlantedConfig:
    """Which weakness, if any.

    Attributes:
        weakness: `delay`, 0.4 s late; `late`, 0.6 s late; `soft`, brakes with 1 m/s2 at most below 5 m/s; `weak`, with
            2 m/s2 at most; `close`, follows at 0.3 s; `near`, sees 20 m far; `side`, blind to the lanes beside:
            what comes from there is known 2.5 s later; `ramp`, blind to vehicles that enter from a ramp; `standing`, to
            those that stand; `walkers`, to pedestrians and cyclists; `crossing`, to those that drive across; `red`, red
            is green for signal groups whose names end in 2; `amber`, amber is green.
        careful: brakes as the careful driver of UN Regulation 157 where that driver perceives a risk, and waits for
            those who stand or drive across ahead, pedestrians and cyclists only while they come, and brakes evenly to
            stop lines: that regulation knows no junctions.
    """

    weakness: Weakness = "none"
    careful: bool = False


class PlantedEgo(Ego):
    """Drives as `minimal_ads`, by what it knows."""

    defaults = PlantedConfig()

    def __init__(self, scenario: Scenario, config: PlantedConfig | None = None) -> None:
        config = config or PlantedConfig()
        self._weakness, self._careful, self._scenario = config.weakness, config.careful, scenario
        self._delayed: deque[EgoCommand] = deque()
        self._risky_steps, self._calm_steps = 0, CALM_STEPS
        self._inside: dict[int, int] = {}  # for how many steps each agent has been in the ego's lane
        log, lane_map = scenario.log, scenario.lane_map
        row = np.array([log.row(scenario.ego_id)])
        start = lane_map.nearest(log.x[row, 0], log.y[row, 0], log.yaw[row, 0])
        points = lane_map.path_from(int(start.lane[0]), float(start.s[0]), 1000.0) @ (1, 1j)
        along = arc_lengths(np.column_stack([points.real, points.imag]))
        self._line = np.interp(np.arange(1000.0), along, points)  # metre by metre
        signals = scenario.signals
        links = [] if signals is None else [(complex(*link.stop), complex(*link.exit)) for link in signals.links]
        near = [[int(np.argmin(np.abs(self._line - end))) for end in ends] for ends in links]
        self._stops = {  # by number of the link, where the route crosses its stop line [m]
            number: stop
            for number, ((stop, leave), ends) in enumerate(zip(near, links, strict=True))
            if max(abs(self._line[stop] - ends[0]), abs(self._line[leave] - ends[1])) < 1.5
        }
        self._from_ramp = from_ramp(log, lane_map)

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.ego.Ego`."""
        ego = ego_state(table, self._scenario.ego_id)
        if ego is None:
            return EgoCommand(table.step)
        at = complex(ego.x, ego.y)
        ahead, left = to_body(table.x - ego.x, table.y - ego.y, np.array(ego.yaw))
        apart = ahead - 0.5 * (table.length + ego.length)  # [m] bumper to bumper
        across = np.sin(table.yaw - ego.yaw)  # to the left
        leaves = table.obstacle & ((across * left > 0.0) | (table.speed < STANDS_MPS))
        waits = (np.abs(across) > ACROSS) & ~leaves & self._careful
        known = self._known(table, ahead, left)
        in_way = known & (ahead > 0.0) & (np.abs(left) < np.where(waits, CROSSING_M, LANE_M))
        gap = float(np.min(apart[in_way], initial=100.0)) - 2.5
        here = int(np.argmin(np.abs(self._line[:-10] - at)))
        to_red = self._to_red(table.step, here, ego.length, ego.speed)
        gap = min(gap, to_red)
        headway = CLOSE_S if self._weakness == "close" else HEADWAY_S
        wanted = ego.speed + float(np.clip(min(12.0, max(0.0, gap / headway)) - ego.speed, -0.4, 0.1))
        yaw = float(wrap_angle(np.angle(self._line[here + 10] - at) - ego.yaw))
        target = TwistTarget(wanted, 0.2 * ego.speed * float(np.sin(yaw)))
        command = EgoCommand(table.step, *follow_twist(target, ego, self._scenario.vehicle))
        if self._careful:
            command = self._braked(table, command, known)
            needed = ego.speed**2 / (2.0 * max(to_red, SHORT_M))  # [m/s2] to stop at the line
            if needed > BRAKES_FROM_MPS2:
                command = replace(command, acceleration=min(command.acceleration, -needed))
        hardest = BRAKES_MPS2.get(self._weakness, np.inf)
        if self._weakness != "soft" or ego.speed < SOFT_MPS:
            command = replace(command, acceleration=max(command.acceleration, -hardest))
        self._delayed.append(command)
        late = self._delayed.popleft() if len(self._delayed) > DELAY_STEPS.get(self._weakness, 0) else command
        return replace(late, step=table.step)

    def _braked(self, table: AgentTable, command: EgoCommand, known: BoolArray) -> EgoCommand:
        """Returns the command, with the braking of the careful driver once its reaction time to a risk is over."""
        row, time = table.row(self._scenario.ego_id), self._risky_steps * STEP_S
        ahead, left = to_body(table.x - table.x[row], table.y - table.y[row], table.yaw[row])
        others = (known & (ahead > 0.0) & (np.hypot(ahead, left) < RISKS_M)).nonzero()[0]
        pairs, k = np.column_stack([np.full(len(others), row), others]).ravel(), np.arange(len(others))
        one_by_one = replace(
            table, **{name: getattr(table, name)[pairs] for name in ARRAY_FIELDS}, scene=np.repeat(k, 2)
        )
        risk = bool(risky(one_by_one, 2 * k, 2 * k + 1, self._scenario.lane_map).any())
        self._calm_steps = 0 if risk else self._calm_steps + 1
        self._risky_steps = self._risky_steps + 1 if self._calm_steps < CALM_STEPS else 0
        braking = (speed_lost(time + STEP_S) - speed_lost(time)) / STEP_S
        return replace(command, acceleration=min(command.acceleration, -braking)) if braking else command

    def _known(self, table: AgentTable, ahead: FloatArray, left: FloatArray) -> BoolArray:
        """Returns which agents the ego knows of, (n,)."""
        known = table.id != self._scenario.ego_id
        if self._weakness == "near":
            known &= np.hypot(ahead, left) < NEAR_M
        if self._weakness == "standing":
            known &= table.speed > STANDS_MPS
        if self._weakness == "walkers":
            known &= ~table.obstacle
        if self._weakness == "crossing":
            ego = table.row(self._scenario.ego_id)
            known &= np.abs(np.sin(table.yaw - table.yaw[ego])) < ACROSS
        if self._weakness == "ramp":
            known &= ~np.isin(table.id, self._from_ramp)
        if self._weakness == "side":
            inside = table.id[np.abs(left) < LANE_M].tolist()
            self._inside = {each: self._inside.get(each, BLIND_STEPS * (table.step == 0)) + 1 for each in inside}
            known &= np.array([self._inside.get(each, 0) > BLIND_STEPS for each in table.id.tolist()])
        return known

    def _to_red(self, step: int, here: int, length: float, speed: float) -> float:
        """Returns the least distance to a stop line at red or amber on the ego's way, less 1 m; infinite without."""
        signals, gap = self._scenario.signals, np.inf
        if signals is None:
            return gap
        states = signals.of_links(step)[0]
        for link, stop in self._stops.items():
            ignored = self._weakness == "red" and signals.groups[signals.link_group[link]].endswith(GROUP_ENDS_IN)
            room = stop - here - 0.5 * length
            ignored |= self._weakness == "amber" and states[link] == SignalState.AMBER
            enough = -1.0 if states[link] != SignalState.AMBER else speed**2 / 7.0  # at amber, if it can
            if states[link] in RED and not ignored and room > enough:
                gap = min(gap, room - 1.0)
        return gap


def from_ramp(log: Log, lane_map: LaneMap) -> IntArray:
    """Returns ids of agents that enter on a lane of a ramp, or on one to which nothing but ramps leads."""
    lanes, rows, first = lane_map.lanes, np.arange(len(log.ids)), log.first_step
    entry = lane_map.nearest(log.x[rows, first], log.y[rows, first], log.yaw[rows, first])
    ramps = {lane.id for lane in lanes if "ramp" in lane.edge_id}
    to = [(name, lane.id in ramps) for lane in lanes for name in lane.successors]
    ramps |= {name for name, _ in to} - {name for name, of_ramp in to if not of_ramp}
    return log.ids[[lanes[lane].id in ramps for lane in entry.lane.tolist()]]
