"""Parameters of the conflict stage: detection, planned motions, the life cycle of takeovers, and passing."""

from __future__ import annotations

from dataclasses import field
from typing import Literal

from pydantic import model_validator

from litsim_policy.motion.lane_change import LaneChangeConfig
from litsim_sim.core.quantities import (
    Acceleration,
    Angle,
    ChangeTime,
    Duration,
    Flag,
    Horizon,
    Length,
    NonNegative,
    Number,
    OpenShare,
    Positive,
    Speed,
    Steps,
    Whole,
    at_most,
    configuration,
)


@configuration
class PlannedMotionConfig:
    """How an agent under control is assumed to continue.

    Attributes:
        used: whether it is expected on its path; otherwise it is forecast as other agents are.
        hold: time for which it keeps its acceleration; after that, it keeps its speed.
        fade: time, after `hold`, within which the forecast's progress along the path takes over.
        settle: time constant of its return to the path.
        sigma_along, sigma_across: growth of the standard deviations, linear and quadratic terms.
        sigma_start: standard deviation at the start.
    """

    used: Flag = True
    hold: NonNegative[Duration] = 1.0
    fade: Positive[Duration] = 2.0
    settle: Positive[Duration] = 1.0
    sigma_along: tuple[NonNegative[Speed], NonNegative[Acceleration]] = (0.05, 0.25)
    sigma_across: tuple[NonNegative[Speed], NonNegative[Acceleration]] = (0.03, 0.0)
    sigma_start: NonNegative[Length] = 0.1


@configuration
class ConflictConfig:
    """When two futures count as a conflict.

    A forecast is a Gaussian around its mean, so two boxes overlap at an instant with a probability. The mean alone is
    the special case `sigma_scale` = 0: the probability is then 1 or 0, and any threshold gives the same. With the
    forecast's spread, threshold 0.5 is nearly the same where only one coordinate is uncertain, as in a lane: the
    probability is a half where the mean boxes touch. Lower thresholds detect a conflict sooner.

    Attributes:
        horizon: of the futures that are compared.
        margin: added to the length of boxes; positive values lead to earlier takeovers.
        probability_threshold: least probability of an overlap at some instant that counts as a conflict.
        probability_clear: likewise for agents that are already off their logs; lower than the threshold, it keeps
            takeovers from flickering.
        sigma_scale: factor on the standard deviations of the forecast.
        braking_time: time for which a hard braking agent is assumed to keep braking, where its forecast expects less;
            0 leaves forecasts unchanged.
        braking_hard: deceleration from which an ego's braking is hard.
        emergency: deceleration from which any agent's braking is hard. No forecast knows the reason for it, and
            agents behind need longer to stop.
        roi_m: radius around an agent off its log within which others are compared; 0 for the scenario's.
        approach_time: others that would reach that radius within this time, at their present rate of approach, are
            compared as well; 0 for the radius alone. Stopping behind a standing agent can take more than 30 m.
        region: off_log: around every agent off its log; ego: the same, but agents are taken over only within `roi_m`
            of the ego.
        closing_time: a conflict within this time is certain and urgent, regardless of the forecast, if it results from
            an agent off its log keeping its acceleration and heading; twice that in an emergency; 0 for the forecast
            alone.
        intent: how agents under control are assumed to continue.
        happened: folder of the outcomes of earlier runs; agents are then taken over by the contacts in it instead of
            predictions, as by an oracle, for experiments; empty for predictions.
    """

    horizon: Horizon = 3.0
    margin: Length = 0.0
    probability_threshold: OpenShare = 0.3
    probability_clear: OpenShare = 0.2
    sigma_scale: NonNegative[Number] = 1.0
    braking_time: NonNegative[Duration] = 1.0
    braking_hard: NonNegative[Acceleration] = 1.0
    emergency: NonNegative[Acceleration] = 4.0
    roi_m: NonNegative[Length] = 0.0
    approach_time: NonNegative[Duration] = 3.0
    region: Literal["off_log", "ego"] = "off_log"
    closing_time: NonNegative[Duration] = 1.0
    intent: PlannedMotionConfig = PlannedMotionConfig()
    happened: str = ""

    @model_validator(mode="after")
    def _check(self) -> ConflictConfig:
        at_most(self, "probability_clear", "probability_threshold")
        return self


@configuration
class PassingConfig:
    """Which agents pass, and how.

    Attributes:
        slower: an agent is held back if it is slower than its log, lag included, by more than this.
        patience: steps in a row for which it is held back before it looks for another lane.
        again: least number of steps from one lane change to the next.
        change_time: duration of a lane change.
        look: distance ahead over which both lanes must lead the same way: enough to change, pass, and change back.
        mobil: criteria of lane changes.
    """

    slower: Positive[Speed] = 0.5
    patience: Positive[Steps] = 1
    again: NonNegative[Steps] = 40
    change_time: ChangeTime = 3.5
    look: NonNegative[Length] = 150.0
    mobil: LaneChangeConfig = field(default_factory=LaneChangeConfig)


@configuration
class TakeoverConfig:
    """When an agent is taken over, handed back and released.

    Attributes:
        confirm_steps: steps in a row that must predict a conflict before a takeover.
        urgent_time: time to a conflict within which the takeover is immediate.
        held_steps_min: least number of steps for which an agent is held.
        clear_steps: steps in a row without conflict before the hand-back begins, once the goal is passed; twice as
            many before.
        iterations_max: bound on the iterations of detection within a step.
        release_position: largest residual with which the hand-back ends.
        release_speed: residual likewise.
        release_yaw: residual likewise.
        handback: catch_up, to the present position of the log; or time_shift, to the position of the log that is
            nearest to the agent, after which the log is replayed with that lag.
        passing: whether agents behind a permanently slow one pass.
        lane_change: conditions and execution of passing.
    """

    confirm_steps: Positive[Steps] = 3
    urgent_time: NonNegative[Duration] = 1.0
    held_steps_min: NonNegative[Steps] = 5
    clear_steps: NonNegative[Steps] = 5
    iterations_max: Positive[Whole] = 10
    release_position: NonNegative[Length] = 0.5
    release_speed: NonNegative[Speed] = 1.5
    release_yaw: NonNegative[Angle] = 0.1
    handback: Literal["catch_up", "time_shift"] = "time_shift"
    passing: Flag = True
    lane_change: PassingConfig = field(default_factory=PassingConfig)
