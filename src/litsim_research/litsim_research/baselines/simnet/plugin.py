"""The baseline called `simnet`: a network predicts an agent's next poses from a raster, and the agent drives there.

SimNet (Bergamini et al. 2021): each agent is rasterised anew at each step, and only the first predicted step is
executed. Raster and network are imported when it drives: runs with other policies do not need them.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from litsim_policy.driving.policy import Policy
from litsim_sim.core.errors import InputError
from litsim_sim.core.history import History
from litsim_sim.core.quantities import configuration
from litsim_sim.core.scene import STEP_S, AgentTable, ControlTable
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.setting import Setting

if TYPE_CHECKING:
    from litsim_research.baselines.simnet.network import SimnetNetwork

SHIPPED = Path(str(resources.files("litsim_research").joinpath("weights/simnet.safetensors")))
"""The packaged weights."""


@configuration
class SimnetConfig:
    """Which network drives.

    Attributes:
        weights: file of the network; empty for the packaged one.
    """

    weights: str = ""


class Simnet(Policy):
    """Drives all agents off their logs as the network predicts their motion.

    It knows neither routes nor goals; lanes and distances are kept only as far as the network has learned to, without
    rules or guards.
    """

    defaults, prefix = SimnetConfig(), "simnet."
    by_region = batched = True

    def __init__(self, scenario: Setting, config: SimnetConfig, network: SimnetNetwork | None = None) -> None:
        from litsim_predictor.inference.raster import raster_of_net
        from litsim_research.baselines.simnet.network import load_network
        from litsim_research.baselines.simnet.raster import FRAMES, Painter

        self._network = network or load_network(Path(config.weights) if config.weights else SHIPPED)
        self._painter = Painter(raster_of_net(scenario.net_path)[1].drawn, scenario.signals)
        self._history = History(FRAMES, ("x", "y", "yaw"))

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :class:`litsim_policy.driving.policy.Policy`.

        Raises:
            InputError: the network predicts something that is no finite number.
        """
        from litsim_research.baselines.simnet.raster import FRAMES, Motions

        self._history.push(table)
        listed = takeovers.takeovers
        if not listed:
            return ControlTable.empty(table.step)
        pose, there = self._history.window(table.id, FRAMES)
        everybody = Motions(pose, there, np.stack([table.length, table.width], axis=-1), table.scene)
        rows = table.rows(np.array([t.agent for t in listed], np.int64))
        future = self._network(self._painter.draw(table.step, everybody, rows)).astype(np.float64)
        if not np.isfinite(future).all():
            raise InputError(
                f"{self._network.source}: not all poses predicted at step {table.step} are finite, expected a trained "
                "network in which no number overflows"
            )
        # The predicted distance, divided by the step, is taken as the speed at its end. If it were taken as the mean
        # speed, small errors of the network would oscillate from step to step with growing amplitude.
        acceleration = (future[:, 0] / STEP_S - table.speed[rows]) / STEP_S
        return ControlTable.of_policy(table, rows, acceleration, future[:, 2] / STEP_S)
