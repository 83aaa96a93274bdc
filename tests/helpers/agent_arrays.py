"""Agents as kernels take them."""

import numpy as np
import numpy.typing as npt

from litsim_sim.core.scene import DTYPES, AgentArrays, Controller


def agent_arrays(agents: int, **columns: npt.ArrayLike) -> AgentArrays:
    """So many agents under control, with these columns and zeros in all others; ids and scenes may be left out."""
    usual = {"id": np.arange(agents), "controller": np.full(agents, Controller.POLICY)} | columns
    types = DTYPES | {"scene": np.int64}
    return AgentArrays(
        *(np.array(np.broadcast_to(usual.get(name, 0), agents), types[name]) for name in AgentArrays._fields)
    )
