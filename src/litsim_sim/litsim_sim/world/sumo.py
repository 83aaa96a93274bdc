"""The SUMO world behind the bridge: every agent is placed in it each step, through libsumo."""

from __future__ import annotations

from pathlib import Path

import libsumo
import numpy as np

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, AgentTable, FloatArray, Kind
from litsim_sim.core.signals import SUMO_LETTERS, SignalState
from litsim_sim.scenario.signals import Signals

_ROUTE, _TYPE = "litsim", "litsim"
_TYPES = {Kind.BICYCLE: "bicycle", Kind.PEDESTRIAN: "pedestrian"}  # SUMO's class and shape; all others are cars
_NEVER = "86400"  # [s] between decisions of SUMO's own driver models, which drive no agent here, but cost time
_KEEP_ROUTE = 2  # moveToXY: exactly there, on the network or off it
_LANE_WITHIN = 10.0  # [m] moveToXY: radius in which SUMO looks for an agent's lane; the default of 100 m takes long


class SumoMirror:
    """One SUMO simulation (libsumo: one per process) that shows the agents of an :class:`AgentTable`."""

    def __init__(self, net_path: Path, seed: int = 0, signals: Signals | None = None) -> None:
        """Load `net_path`; its traffic lights show `signals`, and are off where these are unknown."""
        own = str(seed % 2**31)  # SUMO's are 32 bits wide
        try:
            libsumo.start(
                [
                    *("sumo", "--net-file", str(net_path), "--step-length", str(STEP_S), "--seed", own),
                    *("--default.action-step-length", _NEVER, "--collision.action", "none", "--time-to-teleport", "-1"),
                    *("--no-step-log", "true", "--no-warnings", "true"),
                ]
            )
        except (libsumo.TraCIException, libsumo.FatalTraCIError, RuntimeError) as error:
            raise InputError(f"{net_path}: SUMO cannot load the net: {error}") from error
        edges = [edge for edge in libsumo.edge.getIDList() if not edge.startswith(":")]
        if not edges:
            libsumo.close()
            raise InputError(f"{net_path}: the net holds no edges")
        libsumo.route.add(_ROUTE, [edges[0]])
        libsumo.vehicletype.copy("DEFAULT_VEHTYPE", _TYPE)
        for name in _TYPES.values():
            libsumo.vehicletype.copy(_TYPE, name)
            libsumo.vehicletype.setVehicleClass(name, name)
            libsumo.vehicletype.setShapeClass(name, name)
        self._names: dict[int, str] = {}  # in SUMO, of the agents that are there, ids ascending
        self._signals = signals
        lights = libsumo.trafficlight.getIDList()
        self._links = {light: len(libsumo.trafficlight.getRedYellowGreenState(light)) for light in lights}
        self._lights = dict.fromkeys(lights, "")  # what each was last set to

    def show(self, table: AgentTable) -> None:
        """Place the agents of `table`, remove those that are gone, and advance SUMO by one step."""
        agents, move = table.id.tolist(), libsumo.vehicle.moveToXY
        if agents != list(self._names):
            self._come_and_go(table, agents)
        half = 0.5 * table.length
        front = table.x + half * np.cos(table.yaw), table.y + half * np.sin(table.yaw)
        degrees = (90.0 - np.degrees(table.yaw)) % 360.0
        poses = zip(self._names.values(), *(values.tolist() for values in (*front, degrees)), strict=True)
        for name, x, y, angle in poses:
            move(name, "", -1, x, y, angle, _KEEP_ROUTE, _LANE_WITHIN)
        if self._lights:
            self._show_signals(table.step)
        libsumo.simulationStep()
        self._front = front

    def _come_and_go(self, table: AgentTable, agents: list[int]) -> None:
        """Remove the agents that are gone, and add those of `table`, whose ids are `agents`, that are new."""
        for agent in self._names.keys() - set(agents):
            libsumo.vehicle.remove(self._names[agent])
        for row, agent in enumerate(agents):
            if agent not in self._names:
                self._add(str(agent), int(table.kind[row]), float(table.length[row]), float(table.width[row]))
        self._names = {agent: str(agent) for agent in agents}

    def _add(self, name: str, kind: int, length: float, width: float) -> None:
        """Add an agent, which is placed before SUMO's next step."""
        libsumo.vehicle.add(name, _ROUTE, _TYPE)
        if kind in _TYPES:  # only then: the route may not be for them
            libsumo.vehicle.setType(name, _TYPES[Kind(kind)])
        libsumo.vehicle.setLength(name, length)
        libsumo.vehicle.setWidth(name, width)
        libsumo.vehicle.setSpeedMode(name, 0)
        libsumo.vehicle.setLaneChangeMode(name, 0)

    def _show_signals(self, step: int) -> None:
        """Set the lights that change: a state that is set holds until it is set again."""
        shown = {light: ["O"] * links for light, links in self._links.items()}
        if self._signals is not None:
            states = self._signals.table(step).state
            for link, group in zip(self._signals.links, self._signals.link_group.tolist(), strict=True):
                shown[link.light][link.index] = SUMO_LETTERS[SignalState(states[group])]
        for light, letters in shown.items():
            text = "".join(letters)
            if text != self._lights[light]:
                libsumo.trafficlight.setRedYellowGreenState(light, text)
                self._lights[light] = text

    def deviation(self, table: AgentTable) -> FloatArray:
        """Returns the distance (n,) [m] between front centres in SUMO and where `show` put them; inf if absent."""
        in_sumo = set(libsumo.vehicle.getIDList())
        names = [str(agent) for agent in table.id.tolist()]
        front = np.array([libsumo.vehicle.getPosition(n) if n in in_sumo else (np.inf, np.inf) for n in names])
        front = front.reshape(-1, 2)
        return np.hypot(front[:, 0] - self._front[0], front[:, 1] - self._front[1])

    def close(self) -> None:
        """End the simulation."""
        libsumo.close()
