"""How long a forecast takes, with a given number of agents around the ego."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from litsim_predictor.forecast import Predictor
from litsim_predictor.learned.weights import SHIPPED, path_of
from litsim_predictor.models import MODELS, make_predictor
from litsim_sim.errors import InputError
from litsim_sim.recording import STEP_S, Kind
from litsim_sim.scenario import Scenario
from litsim_sim.scene import AgentTable, Controller

SCENARIO = "demo"
AGENTS_MOST = 250  # more do not fit on the net of the scenario
ROI_M = 1000.0  # [m] everybody is within it
WARM_UP = 40  # steps: 3 s of history and some more
LANES = 5
LANE_WIDTH = 3.66  # [m]
SPACING = 10.0  # [m] between vehicles of a lane
SPEED = 8.0  # [m/s]
SIZE = (4.5, 1.8)  # [m]


@dataclass(frozen=True)
class Timing:
    """Of one call of a predictor [ms]."""

    median: float
    least: float
    most: float

    def __str__(self) -> str:
        return f"{self.median:.2f} ({self.least:.2f} to {self.most:.2f})"


def models_here() -> list[str]:
    """The predictors that need no training, and those whose weights come with the package."""
    return [model for model in MODELS if model not in SHIPPED or path_of(model).is_file()]


def time_models(models: list[str], agents: list[int], steps: int) -> Iterator[tuple[str, int, Timing]]:
    """Time each of `models` with each number of `agents`, over `steps` steps after 3 s of history.

    Raises:
        InputError: there is no such model, or the number of agents does not fit on the road.
    """
    if steps < 1 or not all(1 <= n <= AGENTS_MOST for n in agents):
        raise InputError(f"{agents} agents, {steps} steps: expected 1 to {AGENTS_MOST} agents and 1 step or more")
    scenario = Scenario.load(SCENARIO, roi_m=ROI_M)
    for model in models:
        for n in agents:
            yield model, n, time_predictor(make_predictor(model, scenario), scenario.ego_id, n, steps)


def time_predictor(predictor: Predictor, ego: int, agents: int, steps: int) -> Timing:
    """Time `predictor`, fresh, on `agents` agents of whom one is `ego`.

    Raises:
        InputError: it did not forecast them all.
    """
    walls = []
    for step in range(WARM_UP + steps):
        table = columns_of_traffic(step, ego, agents)
        begin = time.perf_counter()
        forecast = predictor.forecast(table)
        walls.append(1e3 * (time.perf_counter() - begin))
        if len(forecast.id) != agents:
            raise InputError(f"{len(forecast.id)} of {agents} agents were forecast, expected all")
    walls = walls[WARM_UP:]
    return Timing(statistics.median(walls), min(walls), max(walls))


def columns_of_traffic(step: int, ego: int, agents: int) -> AgentTable:
    """Five lanes of vehicles 10 m apart at 8 m/s on the net of :data:`SCENARIO`; the ids begin with `ego`."""
    number = np.arange(agents)
    nothing = np.zeros(agents)
    return AgentTable(
        step=step,
        id=ego + number,
        kind=np.full(agents, Kind.CAR, np.uint8),
        controller=np.where(number == 0, Controller.EGO, Controller.LOG).astype(np.uint8),
        x=15.0 + SPACING * (number // LANES) + 2.0 * (number % LANES) + SPEED * STEP_S * step,
        y=nothing - LANE_WIDTH * (number % LANES + 0.5),
        yaw=nothing,
        speed=nothing + SPEED,
        acceleration=nothing,
        yaw_rate=nothing,
        length=nothing + SIZE[0],
        width=nothing + SIZE[1],
    )
