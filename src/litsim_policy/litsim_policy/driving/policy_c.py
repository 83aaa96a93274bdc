"""Policy C, called `litsim`: held agents drive on as their logs do and follow others as people do, behind one guard."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from litsim_policy.driving.action import executed_yaw_rate, physical
from litsim_policy.driving.features.observation import Observer
from litsim_policy.driving.follower import Follower, FollowerConfig
from litsim_policy.driving.handback import COMFORTABLE, along_log
from litsim_policy.driving.policy import Policy
from litsim_policy.driving.policy_network import PACKAGED, ForeignPolicy, PolicyNetwork, load_policy, shipped_weights
from litsim_policy.driving.safety.layer import SafetyConfig, SafetyLayer
from litsim_policy.driving.task import DrivingScene, lag_of
from litsim_policy.driving.yield_policy import YieldPolicy
from litsim_policy.driving.yielding_rules import keep_distance, make_room, wait_for_crossing
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.stop_lines import StopLines, idm_at_signals
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.quantities import Flag, configuration
from litsim_sim.core.scene import AgentTable, ControlSource, ControlTable, FloatArray
from litsim_sim.core.takeover import PathSource, Takeover, TakeoverTable
from litsim_sim.scenario.setting import Setting

POLICY, GUARDED = int(ControlSource.POLICY), int(ControlSource.GUARDED)  # numpy takes plain numbers much faster


@configuration
class PolicyCConfig:
    """Parameters of :class:`PolicyC`.

    Attributes:
        weights: `none` for no network: agents drive on as their logs do, with the present lag. `critic` is the packaged
            network, trained with a critic after the paper. Else a file that ``litsim_research train policy`` has
            written, or an ONNX file (*.onnx) of a network that was trained in the environment ``litsim/Takeover-v0``.
        rules: whether agents keep their distance, make room, and wait for crossing ones, whatever drives them.
        drivers: `median` for agents that follow those ahead as people usually do, whatever drives them; `drawn` for
            drivers that differ as people do, drawn by the scenario's seed; `none` for no car following.
        follower: the car following.
        safety: the guard.
    """

    weights: str = "none"
    rules: Flag = True
    drivers: Literal["median", "drawn", "none"] = "median"
    follower: FollowerConfig = FollowerConfig()
    safety: SafetyConfig = SafetyConfig()

    def network(self) -> PolicyNetwork | ForeignPolicy | None:
        """Returns the network that `weights` names, if any.

        Raises:
            InputError: it cannot be used.
        """
        if self.weights == "none":
            return None
        return load_policy(shipped_weights(self.weights) if self.weights in PACKAGED else Path(self.weights))


def executed(scene: DrivingScene, action: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Accelerations [m/s2] and yaw rates [rad/s] (m,) of the agents of `scene` for actions (m, 3) in [-1, 1]."""
    wanted = physical(action)
    return wanted[:, 0], executed_yaw_rate(wanted, scene.agents.speed)


def guarded(scene: DrivingScene, acceleration: FloatArray, yaw_rate: FloatArray, safety: SafetyLayer) -> ControlTable:
    """Returns controls of the m agents of `scene` from requested accelerations [m/s2] and yaw rates [rad/s] (m,)."""
    agents, safe = scene.agents, safety.guard(scene, acceleration, yaw_rate)
    source = np.where(safe.guarded, GUARDED, POLICY).astype(np.uint8)
    return ControlTable.without_slip(agents.table, agents.rows, safe.acceleration, safe.yaw_rate, source)


class PolicyC(Policy):
    """The policy called `litsim`: agents that are held drive on as their logs do, or as a network says.

    Whatever drives them, agents follow others as people do, keep to the rules and stop at red lights. Agents that pass
    or return, walkers and cyclists are driven by policy `yield`; passing ones behind the same safety layer.
    """

    batched = True
    drives_walkers = True

    @classmethod
    def read(cls, read: ParameterOverrides) -> Callable[[Setting], Policy]:
        """See :class:`litsim_sim.core.plugins.Configured`."""
        config = read(PolicyCConfig())
        return lambda scenario: cls(scenario, config, config.network())

    def __init__(
        self,
        scenario: Setting,
        config: PolicyCConfig | None = None,
        network: PolicyNetwork | ForeignPolicy | None = None,
    ) -> None:
        config = config or PolicyCConfig()
        self._yielding, self._lane_map = YieldPolicy(scenario), scenario.lane_map
        self._driving = (network, Observer(self._lane_map, network.observation)) if network else None
        self._safety, self._rules = SafetyLayer(config.safety), config.rules
        self._log, self._stop_lines = scenario.log, StopLines(scenario.signals)
        drawn = config.drivers == "drawn"
        self._follower = None if config.drivers == "none" else Follower(scenario, config.follower, drawn=drawn)

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Returns controls of every agent that is off its log."""
        walking = set(table.id[table.obstacle].tolist())
        held = [t for t in takeovers.takeovers if t.state.drives_on and t.agent not in walking]
        passing = [t for t in held if t.path_source == PathSource.LANE]
        keeping = [t for t in held if t.path_source != PathSource.LANE]
        by_rules = [t for t in takeovers.takeovers if not t.state.drives_on or t.agent in walking]
        answers = [(self._keep, keeping), (self._by_rules, by_rules), (self._pass, passing)]
        controls = [answer(table, agents) for answer, agents in answers if agents]
        return ControlTable.merged(ControlTable.empty(table.step), *controls)

    def _keep(self, table: AgentTable, keeping: Sequence[Takeover]) -> ControlTable:
        """Returns controls of agents that keep to their paths."""
        scene = DrivingScene.of_takeovers(self._lane_map, table, keeping)
        if self._driving is None:
            acceleration, yaw_rate = self._onwards(scene.agents, keeping), scene.agents.path_yaw_rate
        else:
            network, observer = self._driving
            acceleration, yaw_rate = executed(scene, network.mean(observer.features(scene)))
        if self._follower is not None:
            since = np.array([takeover.detected_step for takeover in keeping])
            acceleration = self._follower.limited(scene.agents, acceleration, since)
        return guarded(scene, self._within_rules(scene.agents, acceleration), yaw_rate, self._safety)

    def _onwards(self, agents: PathFollowers, takeovers: Sequence[Takeover]) -> FloatArray:
        """Returns accelerations (m,) [m/s2] with which the agents drive on as their logs do, or with those ahead."""
        lag = np.array([lag_of(takeover) for takeover in takeovers])
        onwards, log_speed = along_log(self._log, agents, lag)
        return onwards if self._follower is None else self._follower.along(agents, onwards, log_speed)

    def _within_rules(self, agents: PathFollowers, wanted: FloatArray) -> FloatArray:
        """Returns `wanted` (m,) [m/s2], or less where a rule or a red light demands it.

        Unless `rules` is off, agents keep their distance to those ahead, make room for merging ones and wait for
        crossing ones (:mod:`.yielding_rules`).
        """
        if self._rules:
            paths, table, rows = agents.paths, agents.table, agents.rows
            wanted = keep_distance(wanted, agents.speed, table.length[rows], agents.leaders, COMFORTABLE.values)
            wanted = make_room(wanted, paths, agents.s, table.arrays, rows)
            others = table.off_log | table.obstacle  # vehicles on their logs are the concern of the conflict stage
            wanted = wait_for_crossing(wanted, paths, agents.s, table.arrays, rows, others)
        free = np.full(len(agents), COMFORTABLE.desired_speed)
        return idm_at_signals(COMFORTABLE, agents.speed, free, wanted, self._stop_lines.of(agents))

    def _by_rules(self, table: AgentTable, takeovers: Sequence[Takeover]) -> ControlTable:
        """Returns controls of agents that policy `yield` drives."""
        return self._yielding.act(table, TakeoverTable(table.step, tuple(takeovers)))

    def _pass(self, table: AgentTable, passing: Sequence[Takeover]) -> ControlTable:
        """Controls of passing agents, which brake no harder than is comfortable unless the safety layer demands it.

        Plain car following would brake hard for the leader in the lane that they are leaving.
        """
        asked = self._by_rules(table, passing)
        scene = DrivingScene.of_takeovers(self._lane_map, table, passing)
        braking = np.maximum(asked.acceleration, -COMFORTABLE.deceleration)
        return guarded(scene, braking, asked.yaw_rate, self._safety)
