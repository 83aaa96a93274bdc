"""Made-up agents: as kernels and learned predictors take them, with forecasts and takeovers."""

from typing import Any

import numpy as np
import numpy.typing as npt

from litsim_predictor.forecast import Forecast
from litsim_predictor.inference.contract import HISTORY, AgentInputs
from litsim_predictor.inference.joint.units import TRAFFIC_CHANNELS
from litsim_predictor.inference.raster import CHANNELS, COLUMNS, ROWS
from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, AgentArrays, AgentTable, Controller
from litsim_sim.core.takeover import Takeover, TakeoverReason, TakeoverState, TakeoverTable


def scene(agents: int, seed: int = 0) -> AgentInputs:
    """Agents anywhere within 50 m, at any speed, on a map of noise."""
    rng = np.random.default_rng(seed)
    observed = rng.random((agents, HISTORY)) < 0.8
    observed[:, -1] = True
    history = rng.normal(size=(agents, HISTORY, 4)) * [20.0, 1.0, 0.1, 5.0]
    return AgentInputs(
        frame=np.column_stack([rng.uniform(-50.0, 50.0, (agents, 2)), rng.normal(size=agents)]),
        history=np.where(observed[..., None], history, 0.0).astype(np.float32),
        observed=observed,
        state=np.column_stack([rng.uniform(1.0, 5.0, (agents, 3)), 0.1 * rng.normal(size=agents)]).astype(np.float32),
        raster=rng.integers(0, 256, (agents, CHANNELS, ROWS, COLUMNS), np.uint8),
        traffic=rng.normal(size=(agents, TRAFFIC_CHANNELS)).astype(np.float32),
    )


def table_of(step: int, agents: list[int]) -> AgentTable:
    """Agents whose every column is their position plus a constant of the column."""
    count = len(agents)
    columns = [np.arange(count, dtype=DTYPES[f]) + i for i, f in enumerate(ARRAY_FIELDS)]
    columns[0] = np.array(sorted(agents), np.int64)
    return AgentTable(step, *columns)


def straight_on(table: AgentTable, horizon: float = 5.0, dt: float = 0.2) -> Forecast:
    """Everybody goes on as it moves now, with a spread of 1 m by 0.5 m."""
    t = dt * np.arange(1, round(horizon / dt) + 1)
    heading = np.stack([np.cos(table.yaw), np.sin(table.yaw)], axis=-1)
    gone = (table.speed[:, None] * t)[..., None] * heading[:, None, :]
    mean = np.stack([table.x, table.y], axis=-1)[:, None, :] + gone
    return Forecast(
        step=table.step,
        dt=dt,
        id=table.id,
        mean=mean,
        yaw=np.repeat(table.yaw[:, None], len(t), axis=1).astype(np.float32),
        covariance=np.full((len(table), len(t), 3), [1.0, 0.5, 0.0], np.float32),
        maneuver_probability=np.empty((len(table), 0), np.float32),
        valid=np.ones(len(table), np.bool_),
    )


def agent_arrays(agents: int, **columns: npt.ArrayLike) -> AgentArrays:
    """So many agents under control, with these columns and zeros in all others; ids and scenes may be left out."""
    usual = {"id": np.arange(agents), "controller": np.full(agents, Controller.POLICY)} | columns
    types = DTYPES | {"scene": np.int64}
    return AgentArrays(
        *(np.array(np.broadcast_to(usual.get(name, 0), agents), types[name]) for name in AgentArrays._fields)
    )


def takeover(agent: int, opponent: int = 1, **values: Any) -> Takeover:
    """`agent` is held for its conflict with `opponent`, exactly where its log is; `values` of other fields."""
    usual: dict[str, Any] = {
        "state": TakeoverState.HELD,
        "reason": TakeoverReason.CONFLICT,
        "detected_step": 0,
        "time_to_conflict": 1.0,
        "overlap_probability": 0.5,
        "conflict_pose": (0.0, 0.0, 0.0),
        "goal_pose": (0.0, 0.0, 0.0),
        "reference_path": np.zeros((0, 2)),
        "log_collision_predicted": True,
        "residual_position": 0.0,
        "residual_speed": 0.0,
    }
    return Takeover(agent, opponent, **(usual | values))


def takeovers_in_region(step: int, *agents: int) -> TakeoverTable:
    """Takeovers as those of the baselines, along the middle lane of ``us101_like``."""
    path = np.array([[50.0, -5.49], [600.0, -5.49]])
    return TakeoverTable(
        step, tuple(takeover(each, reason=TakeoverReason.REGION, reference_path=path) for each in agents)
    )
