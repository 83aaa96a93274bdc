"""How long a forecast takes, with a given number of agents around the ego, and the traffic of benchmarks."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from litsim_predictor.forecast import Predictor
from litsim_predictor.inference.predictor import LearnedPredictor
from litsim_predictor.inference.raster import raster_of_net
from litsim_predictor.models import make_predictor
from litsim_predictor.selection import Wanted
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario

SCENARIO = "demo"
AGENTS_MOST = 250  # more do not fit on the net of the scenario
ROI_M = 1000.0  # [m] all agents are within it
WARM_UP = 40  # steps: 3 s of history and some more
LANES = 5
LANE_WIDTH = 3.66  # [m]
SPACING = 10.0  # [m] between vehicles of a lane
SPEED = 8.0  # [m/s]
SIZE = (4.5, 1.8)  # [m]


@dataclass(frozen=True)
class Timing:
    """How long a call of a predictor takes [ms]: median, least and most of many calls."""

    median: float
    least: float
    most: float

    def __str__(self) -> str:
        return f"{self.median:.2f} ({self.least:.2f} to {self.most:.2f})"


def time_models(
    models: Sequence[str], agents: Sequence[int], steps: int, *, by_torch: bool = False
) -> Iterator[tuple[str, int, Timing]]:
    """Time `models` with each number of `agents`, over `steps` steps after 3 s of history.

    They take turns at every step, so that they compare even where the machine has other things to do.

    Args:
        models: names or files.
        agents: numbers of them.
        steps: that are timed.
        by_torch: time learned models run by torch, operator by operator, as well.

    Raises:
        InputError: there is no such model, or no torch; or the number of agents does not fit on the road.
    """
    if steps < 1 or not all(1 <= n <= AGENTS_MOST for n in agents):
        raise InputError(f"{agents} agents, {steps} steps: expected 1 to {AGENTS_MOST} agents and 1 step or more")
    scenario = Scenario.load(SCENARIO, roi_m=ROI_M)
    for n in agents:
        predictors = {model: make_predictor(model, scenario, wanted=Wanted.ALL) for model in models}
        if by_torch:
            predictors |= {f"{model} (torch)": _eager(model, scenario) for model in models if model != "kinematic"}
        yield from ((model, n, timing) for model, timing in time_predictors(predictors, scenario.ego_id, n, steps))


def _eager(model: str, scenario: Scenario) -> Predictor:
    network = plugins.load(plugins.NETWORKS, "torch")(model)
    return LearnedPredictor(network, scenario.ego_id, scenario.roi_m, *raster_of_net(scenario.net_path))


def time_predictors(
    predictors: Mapping[str, Predictor], ego: int, agents: int, steps: int
) -> Iterator[tuple[str, Timing]]:
    """Time `predictors`, all fresh, on `agents` agents, the first of which is `ego`; they take turns at every step.

    Raises:
        InputError: one did not forecast them all.
    """
    walls: dict[str, list[float]] = {name: [] for name in predictors}
    log = Log.from_recording(columns_of_traffic(agents, (WARM_UP + steps) * STEP_S, ego), 0, WARM_UP + steps)
    for step in range(log.steps):
        table = log.table(step)
        for name, predictor in predictors.items():
            begin = time.perf_counter()
            forecast = predictor.forecast(table)
            walls[name].append(1e3 * (time.perf_counter() - begin))
            if len(forecast.id) != agents:
                raise InputError(f"{name}: {len(forecast.id)} of {agents} agents were forecast, expected all")
    for name, of_one in walls.items():
        timed = of_one[WARM_UP:]
        yield name, Timing(statistics.median(timed), min(timed), max(timed))


def columns_of_traffic(agents: int, seconds: float, first_id: int = 1) -> Recording:
    """A recording of `agents` vehicles in five lanes, all at 8 m/s and 10 m apart, for `seconds` [s].

    They are on the net of :data:`SCENARIO`; the ids go up from `first_id`, lane by lane and then back along the road.
    """
    frames = round(seconds / STEP_S) + 1
    number = np.arange(agents)
    x0 = 15.0 + SPACING * (number // LANES) + 2.0 * (number % LANES)
    y0 = -LANE_WIDTH * (number % LANES + 0.5)
    frame, vehicle = (grid.ravel() for grid in np.meshgrid(np.arange(frames), number, indexing="ij"))
    table = pd.DataFrame({"vehicle_id": vehicle + first_id, "frame": frame})
    table["x"] = x0[vehicle] + SPEED * STEP_S * frame
    table["y"] = y0[vehicle]
    table["yaw"] = table["acceleration"] = 0.0
    table["speed"] = SPEED
    table["length"], table["width"] = SIZE
    table["kind"] = int(Kind.CAR)
    table["lane"] = vehicle % LANES + 1
    return Recording.from_table(RecordingHeader("columns", source="generated for the benchmark"), table, "benchmark")
