"""The ego `perturbed`, which follows its log until a seeded time, then brakes, changes lane or ignores others."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import model_validator

from litsim_policy.ego.following import Following, FollowingEgo
from litsim_policy.motion.car_following import IdmConfig
from litsim_policy.motion.reference_path import ReferencePath, lane_change_path, logged_path
from litsim_sim.core.geometry import to_body
from litsim_sim.core.quantities import Acceleration, ChangeTime, Duration, NonNegative, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, EgoCommand, EgoMode
from litsim_sim.lane_map.net_lanes import Lane
from litsim_sim.scenario.scenario import Scenario

FOLLOWING = IdmConfig()
"""Car following after the perturbation, calibrated on NGSIM so that it hardly adds to the perturbation."""
LANE_GAP = 2.0  # [m] least gap behind and ahead at the beginning of a lane change
PATIENCE = 4.0  # [s] for which a lane change waits for that gap; then the ego brakes instead
SPEED_GAIN = 1.0  # [1/s] of the return to the logged speed


@configuration
class PerturbedConfig:
    """Kind and time of the perturbation.

    Attributes:
        kind: brake, lane_change, mixed (one of these two, drawn by the seed), or keep_speed, in which the ego keeps its
            speed and ignores other agents.
        time: earliest and latest beginning after the history, between which the seed draws.
        deceleration: with which it brakes.
        duration: for which it brakes.
        lane_change_time: duration of the move to the centre of the adjacent lane.
    """

    kind: Literal["brake", "lane_change", "mixed", "keep_speed"] = "mixed"
    time: tuple[NonNegative[Duration], NonNegative[Duration]] = (0.0, 4.0)
    deceleration: NonNegative[Acceleration] = 2.0
    duration: NonNegative[Duration] = 2.5
    lane_change_time: ChangeTime = 3.0

    @model_validator(mode="after")
    def _check(self) -> PerturbedConfig:
        if self.time[0] > self.time[1]:
            raise ValueError(f"time is {self.time!r}, expected the earliest before the latest")
        return self


class PerturbedEgo(FollowingEgo):
    """Follows its log exactly up to the perturbation, which is drawn by the scenario's seed and the ego's id.

    Afterwards it drives at the speed of its log at the same place, behind the agent ahead. It does not make up for lost
    time, so that the deviation lasts. A lane change considers agents alongside, but not approaching ones, which must
    react to it.

    Attributes:
        first_step: earliest step at which the ego leaves its log.
        kind: of the perturbation: brake, lane_change or keep_speed.
    """

    defaults = PerturbedConfig()

    def __init__(self, scenario: Scenario, config: PerturbedConfig | None = None) -> None:
        super().__init__(scenario)
        self._config = config or PerturbedConfig()
        random = np.random.default_rng([scenario.seed, scenario.ego_id])
        drawn = random.uniform(*self._config.time)
        changes_lane = int(random.integers(2)) if self._config.kind == "mixed" else 0
        self._left_first = bool(random.integers(2))
        self._row = scenario.log.row(scenario.ego_id)
        self._path: ReferencePath | None = None
        self._brake_from: int | None = None
        self.first_step = scenario.history_steps + round(drawn / STEP_S)
        self.kind = ("brake", "lane_change")[changes_lane] if self._config.kind == "mixed" else self._config.kind

    def following(self, table: AgentTable, row: int) -> Following | EgoCommand:
        """See :class:`.following.FollowingEgo`."""
        if row < 0 or table.step < self.first_step:
            return EgoCommand(table.step, mode=EgoMode.FOLLOW_LOG)
        if self._path is None and not self._begin(table, row):
            return EgoCommand(table.step, mode=EgoMode.FOLLOW_LOG)
        assert self._path is not None
        return self._onwards(table, row, self._path)

    def _begin(self, table: AgentTable, row: int) -> bool:
        """Choose the path of the perturbation, and return whether it begins at this step."""
        waited = (table.step - self.first_step) * STEP_S
        if self.kind == "lane_change" and waited < PATIENCE:
            lane = self._next_lane(table, row)
            if lane is None:
                return False
            reach = float(table.speed[row]) * self._config.lane_change_time
            pose = np.array([table.x[row], table.y[row], table.yaw[row]])
            self._path = lane_change_path(self._scenario.lane_map, pose, lane, reach)
            return True
        self._path = logged_path(self._scenario.log, self._scenario.lane_map, self._scenario.ego_id)
        self._brake_from = table.step
        return True

    def _next_lane(self, table: AgentTable, row: int) -> Lane | None:
        """Returns the adjacent lane on the side drawn first, else on the other side, if no agent is alongside there."""
        lanes = self._scenario.lane_map
        here = lanes.lanes[int(lanes.nearest(table.x[[row]], table.y[[row]], table.yaw[[row]]).lane[0])]
        for name in (here.left, here.right) if self._left_first else (here.right, here.left):
            if name is not None:
                lane = lanes.lanes[lanes.row(name)]
                if not self._taken(table, row, 0.5 * (here.width + lane.width) * (1.0 if name == here.left else -1.0)):
                    return lane
        return None

    def _taken(self, table: AgentTable, row: int, left: float) -> bool:
        """Returns whether an agent is alongside the position `left` [m] to the left of the ego."""
        ahead, beside = to_body(table.x - table.x[row], table.y - table.y[row], table.yaw[row])
        reach = 0.5 * (table.length + table.length[row]) + LANE_GAP
        taken = (np.abs(ahead) < reach) & (np.abs(beside - left) < 0.5 * (table.width + table.width[row]))
        taken &= table.scene == table.scene[row]
        taken[row] = False
        return bool(taken.any())

    def _onwards(self, table: AgentTable, row: int, path: ReferencePath) -> Following:
        """Brake for the duration, then return to the logged speed behind the leader."""
        config, speed = self._config, float(table.speed[row])
        if self.kind == "keep_speed":
            return Following(path, 0.0)
        braked = np.inf if self._brake_from is None else (table.step - self._brake_from) * STEP_S
        if braked < config.duration - 1e-9:
            return Following(path, -config.deceleration)
        wanted = SPEED_GAIN * (self._logged_speed(table, row) - speed)
        wanted = float(np.clip(wanted, -FOLLOWING.deceleration, FOLLOWING.acceleration))
        # the high desired speed leaves only the model's response to leaders
        return Following(path, wanted, FOLLOWING, 2.0 * speed + 10.0)

    def _logged_speed(self, table: AgentTable, row: int) -> float:
        """Returns the speed [m/s] of the log at its position nearest to the ego."""
        log = self._scenario.log
        valid = np.flatnonzero(log.valid[self._row])
        distance = np.hypot(log.x[self._row, valid] - table.x[row], log.y[self._row, valid] - table.y[row])
        return float(log.speed[self._row, valid[np.argmin(distance)]])
