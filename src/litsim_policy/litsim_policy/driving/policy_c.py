"""Policy C: a network drives the agents that are held, within the limits and guards of a safety layer.

The network is a small MLP, so the weights are read from a safetensors file and applied with numpy: the policy node
needs no torch. :mod:`litsim_research.policies.network` is the same network for training in torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from litsim_policy.driving.action import ACTIONS, executed_yaw_rate, physical
from litsim_policy.driving.features.observation import ObservationConfig, Observer
from litsim_policy.driving.handback import COMFORTABLE, CROSSING_HORIZON, OwnLogs
from litsim_policy.driving.network_file import layer_arrays, perceptron, read_network
from litsim_policy.driving.policy import Policy
from litsim_policy.driving.safety.config import SafetyConfig
from litsim_policy.driving.safety.layer import SafetyLayer
from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.driving.yield_policy import YieldPolicy
from litsim_policy.driving.yielding_rules import keep_distance, make_room, wait_for_crossing
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.quantities import Duration, Flag, NonNegative, configuration
from litsim_sim.core.scene import AgentTable, ControlSource, ControlTable, FloatArray
from litsim_sim.core.takeover import PathSource, Takeover, TakeoverState, TakeoverTable
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.setting import Setting
from litsim_sim.scenario.signals import LinkSignals

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

    @classmethod
    def zero(cls, observation: ObservationConfig) -> PolicyNetwork:
        """Returns the network whose mean action is zero."""
        sizes = (observation.size, HIDDEN, HIDDEN, len(ACTIONS))
        return cls(tuple(map(np.zeros, pairwise(sizes))), tuple(map(np.zeros, sizes[1:])), observation)

    def mean(self, observation: FloatArray) -> FloatArray:
        """Returns mean actions (m, 3) in [-1, 1] for observations (m, size)."""
        return np.tanh(self.before_tanh(observation))

    def before_tanh(self, observation: FloatArray) -> FloatArray:
        """Returns the same (m, 3) before the last tanh; a row's values do not depend on the others."""
        return perceptron(observation, self.weights, self.biases)


def shipped_weights(name: str = "policy_c") -> Path:
    """Returns a packaged weights file of policy C."""
    return Path(str(resources.files("litsim_policy").joinpath(f"weights/{name}.safetensors")))


@configuration
class PolicyCConfig:
    """Parameters of :class:`PolicyC`.

    Attributes:
        weights: file of the network, written by ``litsim_research train policy``; empty for the packaged one,
            `residual` for the packaged one that adds to driving on as the log does; or, in place of a network, `none`
            for constant speed straight on, `log` for driving on as the log does with the present lag.
        rules: whether the network's commands are subject to the rules of :class:`PolicyC`.
        guards: whether the guards of `safety` are on; otherwise only its limits are.
        room_horizon: time for which merging agents are expected to continue; others make room for them.
        crossing_horizon: time for which crossing agents are expected to continue; others wait for them.
        safety: limits and guards.
    """

    weights: str = ""
    rules: Flag = True
    guards: Flag = True
    room_horizon: NonNegative[Duration] = 2.5
    crossing_horizon: NonNegative[Duration] = CROSSING_HORIZON
    safety: SafetyConfig = SafetyConfig()

    def network(self) -> PolicyNetwork:
        """Returns the network that `weights` names.

        Raises:
            InputError: it cannot be used.
        """
        if self.weights in ("none", "log"):
            return PolicyNetwork.zero(ObservationConfig(residual=self.weights == "log"))
        if self.weights == "residual":
            return PolicyNetwork.load(shipped_weights("policy_c_residual"))
        return PolicyNetwork.load(Path(self.weights) if self.weights else shipped_weights())


class Driver:
    """The network and the safety layer, independent of runs."""

    def __init__(
        self,
        lane_map: LaneMap,
        network: PolicyNetwork,
        safety: SafetyConfig | None = None,
        signals: LinkSignals | None = None,
    ) -> None:
        self.observer = Observer(lane_map, network.observation)
        self.safety = SafetyLayer(lane_map, safety, signals)
        self._network, self._lane_map, self._residual = network, lane_map, network.observation.residual

    def drive(self, table: AgentTable, tasks: list[DrivingTask]) -> ControlTable:
        """Returns controls of the agents with `tasks`, ids ascending."""
        return self.drive_scene(DrivingScene.of(self._lane_map, table, tasks))

    def drive_scene(self, scene: DrivingScene) -> ControlTable:
        """Returns controls of the agents of `scene`, ids ascending."""
        if not len(scene):
            return ControlTable.empty(scene.agents.table.step)
        return guarded(scene, *self.asked(scene), self.safety)

    def asked(self, scene: DrivingScene) -> tuple[FloatArray, FloatArray]:
        """Commands of the network for the agents of `scene`: accelerations [m/s2] and yaw rates [rad/s] (m,)."""
        return executed(scene, self._network.mean(self.observer.features(scene)), residual=self._residual)


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
    """The policy called `litsim`: the network drives agents that are held, rules drive those that return or pass.

    The network was trained to drive along logs; passing agents are driven by the rules of policy `yield`, behind the
    same safety layer. Unless `rules` is off, the network is also subject to :mod:`.yielding_rules`, since its training
    contained few standing or crossing agents, and no signals: an agent stays in its lane if the side is taken, keeps
    its distance to the agent ahead and to red lights, waits for crossing agents, and makes room for merging ones. A
    residual network is subject to two of them only: what it is added to keeps its distance, and whatever it asks for,
    agents wait for crossing ones and at red lights (:class:`.handback.OwnLogs`).
    """

    batched = True

    @classmethod
    def read(cls, read: ParameterReader) -> Callable[[Setting], Policy]:
        """See :class:`litsim_sim.core.plugins.Configured`."""
        config = read(PolicyCConfig())
        return lambda scenario: cls(scenario, config.network(), config)

    def __init__(self, scenario: Setting, network: PolicyNetwork, config: PolicyCConfig | None = None) -> None:
        config = config or PolicyCConfig()
        safety = config.safety if config.guards else config.safety.without_guards
        self.driver = Driver(scenario.lane_map, network, safety, scenario.signals)
        self._yielding, self._config = YieldPolicy(scenario), config
        self._lane_map, self._logs = scenario.lane_map, OwnLogs(scenario, rules=config.rules)
        self._residual = network.observation.residual

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Returns controls of every agent that is held or handed back."""
        held = [t for t in takeovers.takeovers if t.state == TakeoverState.HELD]
        passing = [t for t in held if t.path_source == PathSource.LANE]
        keeping = [t for t in held if t.path_source != PathSource.LANE]
        returning = [t for t in takeovers.takeovers if t.state != TakeoverState.HELD]
        return merged(self._keep(table, keeping), self._by_rules(table, returning), self._pass(table, passing))

    def _keep(self, table: AgentTable, keeping: Sequence[Takeover]) -> ControlTable:
        """Returns controls of agents that keep to their paths: those of the network, limited by any rules."""
        scene = DrivingScene.of_takeovers(self._lane_map, table, keeping, self._logs)
        if not len(scene):
            return ControlTable.empty(table.step)
        acceleration, yaw_rate = self.driver.asked(scene)
        if self._residual:
            acceleration = self._logs.waiting(scene.agents, acceleration)
        elif self._config.rules:
            acceleration = self._hold_to_rules(scene.agents, acceleration)
            yaw_rate = self._stay_in_lane(scene.agents, yaw_rate)
        return guarded(scene, acceleration, yaw_rate, self.driver.safety)

    def _hold_to_rules(self, agents: PathFollowers, wanted: FloatArray) -> FloatArray:
        """Limit accelerations `wanted` (m,) [m/s2] by the rules of :mod:`.yielding_rules` and red lights."""
        table, rows, safety = agents.table, agents.rows, self._config.safety.values
        kept = keep_distance(wanted, agents.speed, table.length[rows], agents.leaders, COMFORTABLE.values, safety)
        kept = wait_for_crossing(kept, agents.paths.arrays, agents.s, table.arrays, rows, self._config.crossing_horizon)
        kept = make_room(kept, table.arrays, rows, agents.lane.heading, self._config.room_horizon)
        return self._yielding.stop_at_red(agents, kept)

    def _stay_in_lane(self, agents: PathFollowers, yaw_rate: FloatArray) -> FloatArray:
        """Returns yaw rates (m,) [rad/s] as requested, or along the lane where they lead to a side that is taken."""
        to_path, asked = agents.path_yaw_rate - agents.lane_yaw_rate, yaw_rate - agents.lane_yaw_rate
        waits = self._yielding.side_taken(agents, or_will_be=True) & (to_path * asked > 0.0)
        return np.where(waits, agents.lane_yaw_rate, yaw_rate)

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
        return guarded(scene, braking, asked.yaw_rate, self.driver.safety)


def merged(*tables: ControlTable) -> ControlTable:
    """Returns controls of several tables of a step, ids ascending; no agent is in two of them."""
    listed = [table for table in tables if len(table.id)]
    if len(listed) <= 1:
        return listed[0] if listed else tables[0]
    order = np.concatenate([table.id for table in listed]).argsort(kind="stable")

    def column(field: str) -> np.ndarray:
        return np.asarray(np.concatenate([getattr(table, field) for table in listed])[order])

    fields = ("id", "acceleration", "lateral_acceleration", "yaw_rate", "source")
    return ControlTable(tables[0].step, **{field: column(field) for field in fields})


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
