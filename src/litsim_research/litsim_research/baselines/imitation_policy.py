"""The baselines called `gail` and `rail`: all agents in the region drive by a network that imitates traffic.

The network is applied with numpy; :mod:`litsim_research.imitation` trains it.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import ClassVar, Literal, cast, get_args

import numpy as np

from litsim_policy.driving.features.traffic_observation import SIZE, TrafficObserver
from litsim_policy.driving.policy import Policy
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.network_file import Perceptron, layer_arrays, read_network
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.errors import InputError
from litsim_sim.core.quantities import configuration
from litsim_sim.core.scene import AgentTable, ControlTable, FloatArray
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.lane_map.lane_graph import of_streets
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.setting import Setting

HIDDEN = (128, 128, 64)
LAYERS = ("hidden0", "hidden1", "hidden2", "mean")
BOUNDS = np.array([4.0, 0.15])  # [m/s2], [rad/s] acceleration and yaw rate of action 1, as published for highways
LIMITS = VehicleLimits()
SPEED_LEAST = 1.0  # [m/s] below which the largest yaw rate does not fall with the speed, so that it is never zero
Turning = Literal["published", "vehicle"]
"""Yaw rate of action 1: that of BOUNDS, with which nobody turns at a junction, or the vehicle's limit at its speed."""
TURNING = "turning"
"""Key of the metadata of weights; files without it are as published."""
FORMAT = "litsim traffic policy, 1"


@dataclass(frozen=True)
class ImitationNetwork(Perceptron):
    """A Gaussian over actions; its mean, before clipping to [-1, 1], are the outputs of three hidden layers.

    Attributes:
        deviation: (2,) standard deviations of the actions.
        turning: what yaw rate action 1 is.
    """

    deviation: FloatArray
    turning: Turning = "published"

    @classmethod
    def load(cls, path: Path) -> ImitationNetwork:
        """Read what :func:`litsim_research.imitation.network.save` has written.

        Raises:
            InputError: the file is missing, damaged, or holds another network than this version drives with.
        """
        metadata, tensors = read_network(path, "a policy that imitates traffic", FORMAT)
        weights, biases = layer_arrays(path, tensors, LAYERS, (SIZE, *HIDDEN, len(BOUNDS)))
        spread = tensors.get("log_std", np.empty(0))
        if spread.shape != BOUNDS.shape or not np.isfinite(spread).all():
            raise InputError(f"{path}: tensor log_std has shape {spread.shape}, expected {BOUNDS.shape} finite numbers")
        turning = metadata.get(TURNING, "published")
        if turning not in get_args(Turning):
            raise InputError(f"{path}: metadata {TURNING} is {turning!r}, expected {' or '.join(get_args(Turning))}")
        return cls(weights, biases, np.exp(spread.astype(np.float64)), cast(Turning, turning))


@configuration
class ImitationConfig:
    """Parameters of :class:`ImitationPolicy`.

    Attributes:
        weights: file of the network, written by ``litsim_research train imitation``; empty for the packaged one of the
            policy's name, which on streets is another than on motorways.
        actions: `mean` of the Gaussian, or `drawn` from it, by the scenario's seed, the agent's id and the step.
    """

    weights: str = ""
    actions: Literal["mean", "drawn"] = "mean"

    def network(self, name: str, lane_map: LaneMap) -> ImitationNetwork:
        """Returns the network from the file `weights`, or the packaged one of the policy called `name` for `lane_map`.

        Raises:
            InputError: it cannot be used.
        """
        file = f"{name}_streets" if of_streets(lane_map.lanes) else name
        shipped = resources.files("litsim_research").joinpath(f"weights/{file}.safetensors")
        return ImitationNetwork.load(Path(self.weights) if self.weights else Path(str(shipped)))


class ImitationPolicy(Policy):
    """Drives all agents off their logs by the network alone, without rules or guards.

    Attributes:
        name: of the policy, whose packaged network drives unless the configuration names another.
    """

    defaults, prefix = ImitationConfig(), "imitation."
    by_region = batched = True
    name: ClassVar[str]

    def __init__(self, scenario: Setting, config: ImitationConfig, network: ImitationNetwork | None = None) -> None:
        self._lane_map = scenario.lane_map
        self._network = network or config.network(self.name, scenario.lane_map)
        self._observer = TrafficObserver(scenario.lane_map)
        self._agents, self._identities = scenario.log.ids, scenario.identities
        self._draws = config.actions == "drawn"

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :class:`litsim_policy.driving.policy.Policy`."""
        listed = takeovers.takeovers
        if not listed:
            return ControlTable.empty(table.step)
        agents = PathFollowers.of_takeovers(self._lane_map, table, listed)
        action = self._network.outputs(self._observer.observe(agents))
        if self._draws:
            action = action + self._network.deviation * self._noise(table, agents.rows)
        return commanded(agents, action, self._network.turning)

    def _noise(self, table: AgentTable, rows: np.ndarray) -> FloatArray:
        """Returns standard normal numbers (m, 2) for the agents in `rows` (m,), by their seeds, ids and the step."""
        identities = self._identities[np.searchsorted(self._agents, table.id[rows])].tolist()
        drawn = [np.random.default_rng([*identity, table.step]).standard_normal(len(BOUNDS)) for identity in identities]
        return np.array(drawn)


class Gail(ImitationPolicy):
    """The policy called `gail`."""

    name = "gail"


class Rail(ImitationPolicy):
    """The policy called `rail`: GAIL with reward augmentation."""

    name = "rail"


def largest(speed: FloatArray, turning: Turning) -> FloatArray:
    """Returns acceleration and yaw rate of action 1 at speeds (m,) [m/s]: (m, 2) or (1, 2) [m/s2], [rad/s].

    The vehicle's limits on its yaw rate are those of turning radius and lateral acceleration.
    """
    if turning == "published":
        return BOUNDS[None]
    moving = np.maximum(speed, SPEED_LEAST)
    turn = np.minimum(moving * LIMITS.curvature_max, LIMITS.lateral_acceleration_max / moving)
    return np.column_stack([np.full(len(speed), BOUNDS[0]), turn])


def commanded(agents: PathFollowers, action: FloatArray, turning: Turning) -> ControlTable:
    """Returns controls of `agents` from actions (m, 2), clipped to [-1, 1]."""
    wanted = np.minimum(np.maximum(action, -1.0), 1.0) * largest(agents.speed, turning)
    acceleration, yaw_rate = np.ascontiguousarray(wanted[:, 0]), np.ascontiguousarray(wanted[:, 1])
    return ControlTable.of_policy(agents.table, agents.rows, acceleration, yaw_rate)
