"""Policy C, called `litsim`: agents that are held drive on as their logs do, or as a network says.

Either is within the limits and the guard of a safety layer. The network is a small MLP, so the weights are read from a
safetensors file and applied with numpy: the policy node needs no torch. :mod:`litsim_research.policies.network` is the
same network for training in torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from litsim_policy.driving.action import ACTIONS, executed_yaw_rate, physical
from litsim_policy.driving.features.observation import ObservationConfig, Observer
from litsim_policy.driving.handback import COMFORTABLE, OwnLogs
from litsim_policy.driving.network_file import layer_arrays, perceptron, read_network
from litsim_policy.driving.policy import Policy
from litsim_policy.driving.safety.config import SafetyConfig
from litsim_policy.driving.safety.layer import SafetyLayer
from litsim_policy.driving.task import DrivingScene
from litsim_policy.driving.yield_policy import YieldPolicy
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.quantities import Flag, configuration
from litsim_sim.core.scene import AgentTable, ControlSource, ControlTable, FloatArray
from litsim_sim.core.takeover import PathSource, Takeover, TakeoverState, TakeoverTable
from litsim_sim.scenario.setting import Setting

HIDDEN = 128
LAYERS = ("hidden0", "hidden1", "mean")
FORMAT = "litsim policy C, 1"
PARSED: dict[str, Callable[[str], Any]] = {
    "arrange": str,
    "slots": int,
    "sight": float,
    **dict.fromkeys(("ahead", "residual"), {"True": True, "False": False}.__getitem__),
}
"""How each field of the observation is read from a file's metadata."""
POLICY, GUARDED = int(ControlSource.POLICY), int(ControlSource.GUARDED)  # numpy takes plain numbers much faster


@dataclass(frozen=True)
class PolicyNetwork:
    """The mean action as a function of the observation: two hidden layers, tanh throughout.

    Attributes:
        weights: (inputs, outputs) of each layer.
        biases: (outputs,) of each layer.
        observation: with which the network was trained.
    """

    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    observation: ObservationConfig

    @classmethod
    def load(cls, path: Path) -> PolicyNetwork:
        """Read what :func:`litsim_research.policies.network.save` has written.

        Raises:
            InputError: the file is missing, damaged, or holds another network than this version drives with.
        """
        metadata, tensors = read_network(path, "policy C", FORMAT)
        observation = _observation(metadata, path)
        sizes = (observation.size, HIDDEN, HIDDEN, len(ACTIONS))
        return cls(*layer_arrays(path, tensors, LAYERS, sizes), observation)

    def mean(self, observation: FloatArray) -> FloatArray:
        """Returns mean actions (m, 3) in [-1, 1] for observations (m, size)."""
        return np.tanh(self.before_tanh(observation))

    def before_tanh(self, observation: FloatArray) -> FloatArray:
        """Returns the same (m, 3) before the last tanh; a row's values do not depend on the others."""
        return perceptron(observation, self.weights, self.biases)


PACKAGED = ("residual", "critic")


def shipped_weights(name: str) -> Path:
    """Returns one of the :data:`PACKAGED` weights files of policy C."""
    return Path(str(resources.files("litsim_policy").joinpath(f"weights/policy_c_{name}.safetensors")))


@configuration
class PolicyCConfig:
    """Parameters of :class:`PolicyC`.

    Attributes:
        weights: `none` for no network: agents drive on as their logs do, with the present lag. `residual` is a packaged
            network that adds to that, `critic` one that drives alone, trained with a critic after the paper. Else a
            file that ``litsim_research train policy`` has written.
        rules: whether agents wait for crossing ones, and driving on as the log does keeps its distance and makes room;
            see :class:`.handback.OwnLogs`.
        safety: the guard.
    """

    weights: str = "none"
    rules: Flag = True
    safety: SafetyConfig = SafetyConfig()

    def network(self) -> PolicyNetwork | None:
        """Returns the network that `weights` names, if any.

        Raises:
            InputError: it cannot be used.
        """
        if self.weights == "none":
            return None
        return PolicyNetwork.load(shipped_weights(self.weights) if self.weights in PACKAGED else Path(self.weights))


def executed(scene: DrivingScene, action: FloatArray, *, residual: bool) -> tuple[FloatArray, FloatArray]:
    """Accelerations [m/s2] and yaw rates [rad/s] (m,) of the agents of `scene` for actions (m, 3) in [-1, 1].

    With `residual`, the actions are added to what drives the agents on as their logs do, along their paths.
    """
    wanted = physical(action)
    acceleration, yaw_rate = wanted[:, 0], executed_yaw_rate(wanted, scene.agents.speed)
    if residual:
        return acceleration + scene.onwards, yaw_rate + scene.agents.path_yaw_rate
    return acceleration, yaw_rate


def guarded(scene: DrivingScene, acceleration: FloatArray, yaw_rate: FloatArray, safety: SafetyLayer) -> ControlTable:
    """Returns controls of the m agents of `scene` from requested accelerations [m/s2] and yaw rates [rad/s] (m,)."""
    agents, safe = scene.agents, safety.guard(scene, acceleration, yaw_rate)
    source = np.where(safe.guarded, GUARDED, POLICY).astype(np.uint8)
    return ControlTable.without_slip(agents.table, agents.rows, safe.acceleration, safe.yaw_rate, source)


class PolicyC(Policy):
    """The policy called `litsim`: agents that are held drive on as their logs do, or as a network says.

    Whatever a network asks for, agents wait for crossing ones and at red lights. Agents that pass or return are driven
    by the rules of policy `yield`; passing ones behind the same safety layer.
    """

    batched = True

    @classmethod
    def read(cls, read: ParameterReader) -> Callable[[Setting], Policy]:
        """See :class:`litsim_sim.core.plugins.Configured`."""
        config = read(PolicyCConfig())
        return lambda scenario: cls(scenario, config, config.network())

    def __init__(
        self, scenario: Setting, config: PolicyCConfig | None = None, network: PolicyNetwork | None = None
    ) -> None:
        config = config or PolicyCConfig()
        self._yielding, self._lane_map = YieldPolicy(scenario), scenario.lane_map
        self._driving = (network, Observer(self._lane_map, network.observation)) if network else None
        self._safety, self._logs = SafetyLayer(config.safety), OwnLogs(scenario, rules=config.rules)

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Returns controls of every agent that is held or handed back."""
        held = [t for t in takeovers.takeovers if t.state == TakeoverState.HELD]
        passing = [t for t in held if t.path_source == PathSource.LANE]
        keeping = [t for t in held if t.path_source != PathSource.LANE]
        returning = [t for t in takeovers.takeovers if t.state != TakeoverState.HELD]
        return ControlTable.merged(
            self._keep(table, keeping), self._by_rules(table, returning), self._pass(table, passing)
        )

    def _keep(self, table: AgentTable, keeping: Sequence[Takeover]) -> ControlTable:
        """Returns controls of agents that keep to their paths."""
        scene = DrivingScene.of_takeovers(self._lane_map, table, keeping, self._logs)
        if not len(scene):
            return ControlTable.empty(table.step)
        if self._driving is None:
            return guarded(scene, scene.onwards, scene.agents.path_yaw_rate, self._safety)
        network, observer = self._driving
        action = network.mean(observer.features(scene))
        acceleration, yaw_rate = executed(scene, action, residual=network.observation.residual)
        return guarded(scene, self._logs.waiting(scene.agents, acceleration), yaw_rate, self._safety)

    def _by_rules(self, table: AgentTable, takeovers: Sequence[Takeover]) -> ControlTable:
        """Returns controls of agents that policy `yield` drives."""
        return self._yielding.act(table, TakeoverTable(table.step, tuple(takeovers)))

    def _pass(self, table: AgentTable, passing: Sequence[Takeover]) -> ControlTable:
        """Controls of passing agents, which brake no harder than is comfortable unless the safety layer demands it.

        Plain car following would brake hard for the leader in the lane that they are leaving.
        """
        asked = self._by_rules(table, passing)
        if not passing:
            return asked
        scene = DrivingScene.of_takeovers(self._lane_map, table, passing)
        braking = np.maximum(asked.acceleration, -COMFORTABLE.deceleration)
        return guarded(scene, braking, asked.yaw_rate, self._safety)


def _observation(metadata: dict[str, str], path: Path) -> ObservationConfig:
    """Returns the observation in a file's metadata; older files lack fields."""
    usual = {"observation.ahead": "False", "observation.residual": "False"}
    values = {field: (usual | metadata).get(f"observation.{field}", "") for field in vars(ObservationConfig())}
    try:
        return ObservationConfig(**{field: parse(values[field]) for field, parse in PARSED.items()})
    except (ValueError, KeyError) as error:
        given = ", ".join(f"{field} {value!r}" for field, value in values.items())
        raise InputError(
            f"{path}: metadata observation is {given}, expected arrange sector or distance, slots a number, sight in "
            "metres, and the others True or False"
        ) from error
