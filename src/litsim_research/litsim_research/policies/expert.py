"""Expert pairs: observations and actions of interacting recorded vehicles, for the warm start and the critic.

The drivers are people in NGSIM, and SUMO's driver models in generated segments.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch

from litsim_policy.driving.action import consistent, normalised
from litsim_policy.driving.features.observation import ObservationConfig, Observer
from litsim_policy.motion.along_path import Poses
from litsim_policy.motion.reference_path import ReferencePath, logged_path, pursuit_yaw_rate, window
from litsim_research.policies.ppo import Demonstrations, tensor
from litsim_research.policies.task import TaskConfig, recorded_task
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import to_body
from litsim_sim.core.quantities import Angle, Length, NonNegative, Positive, Share, Speed, Steps, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.batched import BatchedScenario, kind
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

AT_ONCE = 64  # scenarios of one kind that are observed together
T = TypeVar("T")


@configuration
class PairsConfig:
    """Which pairs are taken from recorded drivers.

    Attributes:
        every: steps between the pairs of a vehicle.
        smooth: steps over which motion is averaged, since recorded accelerations jitter from frame to frame.
        real_share: share of people's pairs in the draws, where there are any; the others are of SUMO's drivers, which
            give far more pairs.
        offset, turn: standard deviations by which vehicles are displaced for pairs that lead back to the path; only the
            warm start learns from those.
    """

    every: Positive[Steps] = 5
    smooth: Positive[Steps] = 3
    real_share: Share = 0.5
    offset: NonNegative[Length] = 0.4
    turn: NonNegative[Angle] = 0.03


@configuration
class ExpertConfig(PairsConfig):
    """Which pairs are taken from recorded drivers that interact with others.

    Attributes:
        ahead, beside: distances to another vehicle within which the two interact: straight ahead, in any direction.
        speed_min: least speed of the driver, since a standing vehicle shows nothing about steering.
        horizon: least number of steps for which the vehicle stays in the recording after the pair.
    """

    ahead: NonNegative[Length] = 50.0
    beside: NonNegative[Length] = 12.0
    speed_min: NonNegative[Speed] = 0.5
    horizon: Positive[Steps] = 5


@dataclass(frozen=True)
class ExpertPairs:
    """Observations and the actions taken, n pairs.

    Attributes:
        observation: (n, size).
        action: (n, actions) in [-1, 1].
        displaced: (n, size) observations of the same moments with the vehicle displaced.
        correction: (n, actions) actions that lead from there back to the path, in [-1, 1].
        real: (n,) whether the driver was a person.
    """

    observation: FloatArray
    action: FloatArray
    displaced: FloatArray
    correction: FloatArray
    real: BoolArray

    @classmethod
    def of(
        cls, scenarios: Sequence[T], pairs_of: Callable[[T], Iterator[tuple[FloatArray, ...]]], real: Sequence[bool]
    ) -> ExpertPairs:
        """Returns the pairs of `scenarios`; `pairs_of` yields the first four columns for steps of one of them.

        `real` tells of each whether people drove.

        Raises:
            InputError: there are none.
        """
        parts = [
            (*columns, np.full(len(columns[0]), people))
            for scenario, people in zip(scenarios, real, strict=True)
            for columns in pairs_of(scenario)
        ]
        if not parts:
            raise InputError("training: no driver to learn from, expected scenarios with vehicles that interact")
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def demonstrations(self, real_share: float) -> tuple[Demonstrations, Demonstrations]:
        """Returns recorded pairs (n), and these together with the corrections of displaced vehicles (2 n).

        People's pairs have the share `real_share` in both.
        """
        weight = torch.as_tensor(share_weights(self.real, real_share))
        recorded = Demonstrations(tensor(self.observation), tensor(self.action), weight)
        observation = tensor(np.concatenate([self.observation, self.displaced]))
        action = tensor(np.concatenate([self.action, self.correction]))
        return recorded, Demonstrations(observation, action, torch.cat([weight, weight]))


def expert_pairs(
    scenarios: Sequence[Scenario],
    observation: ObservationConfig,
    config: ExpertConfig,
    task: TaskConfig,
    random: np.random.Generator,
    real: Collection[str] = (),
    reported: Mapping[str, Collection[int]] | None = None,
) -> ExpertPairs:
    """Pairs of all vehicles of `scenarios`, including the egos, which do not deviate in a recording.

    Actions come from inverse dynamics: the commands with which the bicycle model would move as recorded. `real` names
    the scenarios in which people drove; `reported` are ids of drivers to
    leave out, by scenario.
    """
    groups = defaultdict[Hashable, list[Scenario]](list)
    for scenario in scenarios:
        groups[kind(scenario), scenario.name in real].append(scenario)
    left_out = {name: sorted(ids) for name, ids in (reported or {}).items()}
    parts = [part for group in groups.values() for part in _portions(group)]
    people = [part[0].name in real for part in parts]

    def of(part: Sequence[Scenario]) -> Iterator[tuple[FloatArray, ...]]:
        batch = BatchedScenario.of(part)
        own = [np.isin(scenario.log.ids, left_out.get(scenario.name, [])) for scenario in part]
        return _of_batch(batch, observation, config, task, random, batch.log.ids[np.concatenate(own)])

    return ExpertPairs.of(parts, of, people)


def _portions(group: Sequence[Scenario]) -> Iterator[Sequence[Scenario]]:
    """Yields the scenarios of a `group`, AT_ONCE at a time."""
    for first in range(0, len(group), AT_ONCE):
        yield group[first : first + AT_ONCE]


def _of_batch(
    scenario: BatchedScenario,
    observation: ObservationConfig,
    config: ExpertConfig,
    task: TaskConfig,
    random: np.random.Generator,
    left_out: IntArray,
) -> Iterator[tuple[FloatArray, ...]]:
    """Yields the first four columns of :class:`ExpertPairs` for steps of one batch, without the drivers `left_out`."""
    log, observer = scenario.log, Observer(scenario.lane_map, observation)
    paths = {}
    for table, rows, stays in moments(log, config, config.horizon):
        chosen = np.flatnonzero(stays & _interacts(table, config) & ~np.isin(table.id, left_out))
        if not len(chosen):
            continue
        tasks = []
        for row in chosen.tolist():
            agent = int(table.id[row])
            if agent not in paths:
                paths[agent] = logged_path(log, scenario.lane_map, agent)
            path = window(paths[agent], float(table.x[row]), float(table.y[row]))
            tasks.append(recorded_task(log, path, table, row, task, random))
        acceleration, yaw_rate = inverse_dynamics(log, rows[chosen], table.step, config.smooth)
        speed = table.speed[chosen]
        poses, steering = displaced(table, chosen, [task.path for task in tasks], config.offset, config.turn, random)
        action, correction = (normalised(consistent(acceleration, turn, speed)) for turn in (yaw_rate, steering))
        yield observer.observe(table, tasks), action, observer.observe(table, tasks, poses), correction


def moments(log: Log, config: PairsConfig, horizon: int = 0) -> Iterator[tuple[AgentTable, IntArray, BoolArray]]:
    """Yields the table of every step of which pairs are taken, and of its agents (n,) rows in the log and who stays.

    An agent stays whose log lasts for `horizon` steps more, and for those over which motion is averaged.
    """
    for step in range(0, log.steps, config.every):
        table = log.table(step)
        rows = np.searchsorted(log.ids, table.id)
        yield table, rows, log.last_step[rows] - step >= max(horizon, config.smooth)


def _interacts(table: AgentTable, config: ExpertConfig) -> np.ndarray:
    """Mask (n,) of the vehicles of `table` that move and interact with another one; see :class:`ExpertConfig`."""
    dx, dy = table.x[None] - table.x[:, None], table.y[None] - table.y[:, None]
    ahead, left = to_body(dx, dy, table.yaw[:, None])
    same = table.scene[None] == table.scene[:, None]
    leads = (ahead > 0) & (ahead < config.ahead) & (np.abs(left) < 0.5 * (table.width[None] + table.width[:, None]))
    beside = (np.hypot(dx, dy) < config.beside) & ~np.eye(len(table), dtype=np.bool_)
    return np.asarray(((leads | beside) & same).any(axis=1) & (table.speed >= config.speed_min) & ~table.obstacle)


def inverse_dynamics(log: Log, rows: np.ndarray, step: int, smooth: int) -> tuple[FloatArray, FloatArray]:
    """Mean acceleration [m/s2] and yaw rate [rad/s] (m,) of the log over the `smooth` steps after `step`."""
    span = smooth * STEP_S
    turn = log.yaw[rows, step + smooth] - log.yaw[rows, step]
    turn = np.arctan2(np.sin(turn), np.cos(turn))
    return (log.speed[rows, step + smooth] - log.speed[rows, step]) / span, turn / span


def displaced(
    table: AgentTable,
    chosen: np.ndarray,
    paths: Sequence[ReferencePath],
    offset: float,
    turn: float,
    random: np.random.Generator,
) -> tuple[Poses, FloatArray]:
    """Displace the vehicles in the rows `chosen` (m,), which follow `paths` (m), each independently of the others.

    The displacements to the left and of the heading are normal, with standard deviations `offset` [m] and `turn` [rad].

    Returns:
        x, y [m] and yaw [rad] of the displaced vehicles, (m,) each, and the yaw rates (m,) [rad/s] of pure pursuit of
        their paths from there.
    """
    draws = [(random.normal(0.0, offset), random.normal(0.0, turn)) for _ in paths]
    left, turned = np.array(draws).reshape(-1, 2).T
    yaw = table.yaw[chosen]
    poses = table.x[chosen] - left * np.sin(yaw), table.y[chosen] + left * np.cos(yaw), yaw + turned
    columns = (values.tolist() for values in (*poses, table.speed[chosen]))
    steering = [pursuit_yaw_rate(path, *own) for path, *own in zip(paths, *columns, strict=True)]
    return poses, np.array(steering)


def share_weights(real: BoolArray, real_share: float) -> FloatArray:
    """Weights (n,) with sum 1; those of the mask `real` (n,) have the sum `real_share` where there are both kinds."""
    people = int(real.sum())
    if people in {0, len(real)}:
        return np.full(len(real), 1.0 / max(len(real), 1))
    return np.where(real, real_share / people, (1.0 - real_share) / (len(real) - people))
