"""Made-up agents of a scene in the form of a learned predictor's inputs."""

import numpy as np

from litsim_predictor.inference.contract import HISTORY, AgentInputs
from litsim_predictor.inference.joint.units import TRAFFIC_CHANNELS
from litsim_predictor.inference.raster import CHANNELS, COLUMNS, ROWS


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
