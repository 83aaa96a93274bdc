"""The ego `planted`: `idm` with a weakness planted in it, to see whether a search finds it."""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from litsim_policy.ego.ego import Ego
from litsim_policy.ego.idm import IdmEgo
from litsim_policy.motion.car_following import IdmConfig
from litsim_sim.core.geometry import to_body
from litsim_sim.core.quantities import configuration
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.core.signals import STOP_STATES, SignalState
from litsim_sim.scenario.scenario import Scenario

BRISK = IdmConfig(desired_speed=15.0, headway=1.2, standstill_gap=2.0, acceleration=1.5, deceleration=3.0)
"""Keeps up with traffic, so that what happens ahead matters."""
BRAKING_MAX = 4.0  # [m/s2] as minimal_ads brakes
OWN_LANE_M, BLIND_STEPS = (
    1.5,
    15,
)  # the blind side: [m] to the side, and [steps] until what has come from there is known
DELAY_STEPS = 4  # [steps]


@configuration
class PlantedConfig:
    """Which weakness.

    Attributes:
        weakness: `none`; `side`, blind to the side: what comes from there is known 1.5 s later; `delay`, 0.4 s late;
            `ramp`, blind to vehicles that it has first seen to its right; `red`, red is green for signal groups whose
            names end in 1.
    """

    weakness: Literal["none", "side", "delay", "ramp", "red"] = "none"


class PlantedEgo(Ego):
    """Drives as `idm`, by what it knows."""

    defaults = PlantedConfig()

    def __init__(self, scenario: Scenario, config: PlantedConfig | None = None) -> None:
        self._weakness, self._scenario = (config or PlantedConfig()).weakness, scenario
        self._delayed: deque[EgoCommand] = deque()
        self._ahead: dict[int, int] = {}  # for how many steps each agent has been ahead in the ego's lane
        self._first: dict[int, float] = {}  # where each agent was first seen, to the left of the ego [m]
        own = scenario
        if self._weakness == "red" and scenario.signals is not None:
            own, signals = copy.copy(scenario), scenario.signals
            states = signals.states.copy()
            rows = [row for row, name in enumerate(signals.groups) if name.endswith("1")]
            states[rows] = np.where(np.isin(states[rows], STOP_STATES), int(SignalState.GREEN), states[rows])
            own.signals = replace(signals, states=states)
        self._idm = IdmEgo(own, BRISK)

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.ego.Ego`."""
        command = self._idm.plan(self._known(table))
        command = replace(command, acceleration=max(command.acceleration, -BRAKING_MAX))
        if self._weakness != "delay":
            return command
        self._delayed.append(command)
        late = self._delayed.popleft() if len(self._delayed) > DELAY_STEPS else command
        return replace(late, step=table.step)

    def _known(self, table: AgentTable) -> AgentTable:
        """Returns the agents that the ego knows of, itself included."""
        row = table.row(self._scenario.ego_id)
        if row < 0 or self._weakness not in ("side", "ramp"):
            return table
        _, left = to_body(table.x - table.x[row], table.y - table.y[row], table.yaw[row])
        if self._weakness == "ramp":
            for agent, beside in zip(table.id.tolist(), left.tolist(), strict=True):
                self._first.setdefault(agent, beside)
            known = np.array([self._first[agent] > -OWN_LANE_M for agent in table.id.tolist()])
        else:
            inside = table.id[np.abs(left) < OWN_LANE_M].tolist()
            self._ahead = {agent: self._ahead.get(agent, BLIND_STEPS if table.step == 0 else 0) + 1 for agent in inside}
            known = np.array([self._ahead.get(agent, 0) > BLIND_STEPS for agent in table.id.tolist()])
        known[row] = True
        return table.take(known)


def install(folder: Path) -> dict[str, str]:
    """Writes the entry point of the ego to `folder`; returns the variable by which programs find it."""
    info = folder / "planted_egos-1.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: planted-egos\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[litsim.egos]\nplanted = planted_egos:PlantedEgo\n")
    return {"PYTHONPATH": f"{folder}:{Path(__file__).parent}"}
