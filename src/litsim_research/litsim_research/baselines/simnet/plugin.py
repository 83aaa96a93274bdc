"""The policy `simnet`, without the imports of its code, which runs with other policies do not need."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Literal

from litsim_policy.driving.policy import Policy
from litsim_sim.core.errors import InputError
from litsim_sim.core.quantities import configuration
from litsim_sim.core.scene import AgentTable, ControlTable
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.setting import Setting

SHIPPED = Path(str(resources.files("litsim_research").joinpath("weights/simnet.safetensors")))
"""The packaged weights, of the small backbone."""


@configuration
class SimnetConfig:
    """Which network drives.

    Attributes:
        backbone: `small`, which is packaged, on a raster of 96 x 48 cells of 1 m; or the paper's `resnet50`, on 224 x
            224 cells of 0.5 m, with weights from ``litsim_research train simnet``.
        weights: file of the network; empty for the packaged one.
    """

    backbone: Literal["small", "resnet50"] = "small"
    weights: str = ""

    def file(self) -> Path:
        """Returns the file of the network.

        Raises:
            InputError: `weights` is not a file for this backbone.
        """
        if not self.weights and self.backbone != "small":
            raise InputError(
                f"policy: parameter simnet.weights is empty, expected a file for backbone {self.backbone}: none comes "
                f"with LitSim; litsim_research train simnet makes one"
            )
        path = Path(self.weights) if self.weights else SHIPPED
        expected = ".safetensors" if self.backbone == "small" else ".onnx"
        if path.suffix != expected:
            raise InputError(
                f"policy: parameter simnet.weights is {self.weights!r}, expected a file {expected} for backbone "
                f"{self.backbone}"
            )
        return path


class Simnet(Policy):
    """The policy called `simnet`, see :class:`litsim_research.baselines.simnet.policy.SimnetPolicy`."""

    defaults, prefix = SimnetConfig(), "simnet."
    by_region = batched = True

    def __init__(self, scenario: Setting, config: SimnetConfig) -> None:
        from litsim_research.baselines.simnet.network import load_network
        from litsim_research.baselines.simnet.policy import SimnetPolicy

        self._policy = SimnetPolicy(scenario, load_network(config.file()))

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :class:`litsim_policy.driving.policy.Policy`."""
        return self._policy.act(table, takeovers)
