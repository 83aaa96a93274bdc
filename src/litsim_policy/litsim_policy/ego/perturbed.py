"""The ego that follows its log until a seeded moment, then brakes, changes lane or no longer minds others."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import model_validator

from litsim_policy.ego.following import Following, FollowingEgo
from litsim_policy.motion.car_following import IdmConfig
from litsim_policy.motion.reference_path import ReferencePath, lane_change_path, logged_path
from litsim_sim.core.geometry import to_body
from litsim_sim.core.quantities import Acceleration, Duration, Length, NonNegative, Positive, Rate, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, EgoCommand, EgoMode
from litsim_sim.maps.net_lanes import Lane
from litsim_sim.scenario.scenario import Scenario

KINDS = ("brake", "lane_change", "mixed", "keep_speed")
FOLLOWING = IdmConfig()
"""Car following after the perturbation: the parameters calibrated on NGSIM, so that little is added to it."""


@configuration
class PerturbedConfig:
    """What happens to the log, and when.

    Attributes:
        kind: brake, lane_change, or mixed, which is either of the two as the seed says; or keep_speed: from then on the
            ego keeps its speed, whatever is ahead.
        time: after the history, between which (earliest, latest) the seed puts the perturbation; equal fixes it.
        deceleration: of braking.
        duration: of braking.
        lane_change_time: that the way to the centre of the next lane takes.
        lane_gap: free road behind and ahead that a lane change needs where it begins.
        patience: time for which a lane change waits for that gap; then the ego brakes instead.
        speed_gain: of the return to the logged speed.
    """

    kind: Literal["brake", "lane_change", "mixed", "keep_speed"] = "mixed"
    time: tuple[NonNegative[Duration], NonNegative[Duration]] = (0.0, 4.0)
    deceleration: NonNegative[Acceleration] = 2.0
    duration: NonNegative[Duration] = 2.5
    lane_change_time: Positive[Duration] = 3.0
    lane_gap: NonNegative[Length] = 2.0
    patience: NonNegative[Duration] = 4.0
    speed_gain: Positive[Rate] = 1.0

    @model_validator(mode="after")
    def _check(self) -> PerturbedConfig:
        if self.time[0] > self.time[1]:
            raise ValueError(f"time is {self.time!r}, expected the earliest before the latest")
        return self


class PerturbedEgo(FollowingEgo):
    """Follows its log exactly up to the perturbation; the scenario's seed and the ego's id decide what and when.

    Afterwards it drives at the speed that its log had at the same place, behind the agent ahead. It does not make up
    for lost time, so its followers meet a lasting deviation. A lane change considers agents alongside, but not those
    approaching: the background has to cope with that.
    """

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
        """Step from which on the ego is off its log, at the earliest."""
        self.kind = ("brake", "lane_change")[changes_lane] if self._config.kind == "mixed" else self._config.kind
        """What it does from then on: brake, lane_change, or another of KINDS."""

    def following(self, table: AgentTable, row: int) -> Following | EgoCommand:
        """See :class:`.following.FollowingEgo`."""
        if row < 0 or table.step < self.first_step:
            return EgoCommand(table.step, mode=EgoMode.FOLLOW_LOG)
        if self._path is None and not self._begin(table, row):
            return EgoCommand(table.step, mode=EgoMode.FOLLOW_LOG)
        assert self._path is not None
        return self._onwards(table, row, self._path)

    def _begin(self, table: AgentTable, row: int) -> bool:
        """Choose the path of the perturbation; returns whether it begins at this step."""
        waited = (table.step - self.first_step) * STEP_S
        if self.kind == "lane_change" and waited < self._config.patience:
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
        """The lane on the side that the seed prefers, else on the other one, if no agent is alongside there."""
        lanes = self._scenario.lane_map
        here = lanes.lanes[int(lanes.nearest(table.x[[row]], table.y[[row]], table.yaw[[row]]).lane[0])]
        for name in (here.left, here.right) if self._left_first else (here.right, here.left):
            if name is not None:
                lane = lanes.lanes[lanes.row(name)]
                if not self._taken(table, row, 0.5 * (here.width + lane.width) * (1.0 if name == here.left else -1.0)):
                    return lane
        return None

    def _taken(self, table: AgentTable, row: int, left: float) -> bool:
        """Whether an agent is alongside a place that lies `left` [m] to the left."""
        ahead, beside = to_body(table.x - table.x[row], table.y - table.y[row], table.yaw[row])
        reach = 0.5 * (table.length + table.length[row]) + self._config.lane_gap
        taken = (np.abs(ahead) < reach) & (np.abs(beside - left) < 0.5 * (table.width + table.width[row]))
        taken &= table.scene == table.scene[row]
        taken[row] = False
        return bool(taken.any())

    def _onwards(self, table: AgentTable, row: int, path: ReferencePath) -> Following:
        """Brake while that lasts; then go back to the logged speed, but never into a leader."""
        config, speed = self._config, float(table.speed[row])
        if self.kind == "keep_speed":
            return Following(path, 0.0)
        braked = np.inf if self._brake_from is None else (table.step - self._brake_from) * STEP_S
        if braked < config.duration - 1e-9:
            return Following(path, -config.deceleration)
        wanted = config.speed_gain * (self._logged_speed(table, row) - speed)
        wanted = float(np.clip(wanted, -FOLLOWING.deceleration, FOLLOWING.acceleration))
        # alone on the road the model would speed up: only its response to leaders is used
        return Following(path, wanted, FOLLOWING, 2.0 * speed + 10.0)

    def _logged_speed(self, table: AgentTable, row: int) -> float:
        """Speed [m/s] that the log had nearest to where the ego is now; beyond its end, at its end."""
        log = self._scenario.log
        valid = np.flatnonzero(log.valid[self._row])
        distance = np.hypot(log.x[self._row, valid] - table.x[row], log.y[self._row, valid] - table.y[row])
        return float(log.speed[self._row, valid[np.argmin(distance)]])
