"""The ego `onnx`, which a network drives that was trained in `litsim/Ego-v0`."""

from __future__ import annotations

from pathlib import Path

from litsim_policy.ego.ego import Ego
from litsim_policy.motion.network_graph import NetworkGraph
from litsim_research.gym.ego_view import ACTIONS, OBSERVED, EgoView, command_of
from litsim_sim.core.errors import InputError
from litsim_sim.core.quantities import configuration
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.scenario.scenario import Scenario


@configuration
class NetworkEgoConfig:
    """Which network drives.

    Attributes:
        weights: ONNX file of a network that was trained in the environment ``litsim/Ego-v0``.
    """

    weights: str = ""


class NetworkEgo(Ego):
    """Drives by a network alone, without rules or guards."""

    defaults = NetworkEgoConfig()

    def __init__(self, scenario: Scenario, config: NetworkEgoConfig) -> None:
        """Read the network; raises as :class:`litsim_policy.motion.network_graph.NetworkGraph`."""
        if not config.weights:
            raise InputError("ego: parameter weights is empty, expected the ONNX file of a network")
        self._view, self._network = EgoView(scenario), NetworkGraph(Path(config.weights), OBSERVED, ACTIONS)

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.ego.Ego`."""
        if not self._view.drives(table):
            return EgoCommand(table.step)
        return command_of(table.step, self._network.actions(self._view.observe(table))[0])
