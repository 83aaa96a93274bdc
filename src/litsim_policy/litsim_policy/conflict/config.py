"""Parameters of the conflict stage: detection, and the life cycle of takeovers."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from litsim_sim.core.quantities import (
    Acceleration,
    Duration,
    Flag,
    Horizon,
    Length,
    NonNegative,
    Number,
    OpenShare,
    Positive,
    Steps,
    at_most,
    configuration,
)


@configuration
class ConflictConfig:
    """When two futures count as a conflict, and when agents are taken over, handed back and released.

    A forecast is a Gaussian around its mean, so two boxes overlap at an instant with a probability. The mean alone is
    the special case `sigma_scale` = 0: the probability is then 1 or 0, and any threshold gives the same. With the
    forecast's spread, threshold 0.5 is nearly the same where only one coordinate is uncertain, as in a lane: the
    probability is a half where the mean boxes touch. Lower thresholds detect a conflict sooner.

    Attributes:
        horizon: time over which futures are compared.
        margin: what is added to the length of boxes; positive values lead to earlier takeovers.
        probability_threshold: least probability of an overlap at some instant that counts as a conflict.
        probability_clear: likewise for agents that are already off their logs; lower than the threshold, it keeps
            takeovers from flickering.
        sigma_scale: factor on the standard deviations of the forecast.
        braking_time: time for which a hard braking agent is assumed to keep braking, where its forecast expects less;
            0 leaves forecasts unchanged.
        emergency: deceleration from which any agent's braking is hard. No forecast knows the reason for it, and
            agents behind need longer to stop. It is more than policy `litsim` brakes by without its guard, 4.05 m/s2.
        roi_m: radius around an agent off its log within which others are compared; 0 for the scenario's.
        approach_time: others that would reach that radius within this time, at their present rate of approach, are
            compared as well; 0 for the radius alone. Stopping behind a standing agent can take more than 30 m.
        region: off_log: around every agent off its log; ego: the same, but agents are taken over only within `roi_m`
            of the ego.
        baselines: whom policies drive that know no conflicts, as the baselines of the paper: ego: all agents that come
            within `roi_m` of the ego, until they leave the net; all: all agents from the first step on, likewise;
            conflict: those that other policies would be given, taken over and released in the same way. The last needs
            `forecast_all` of the predictor.
        closing_time: a conflict within this time is certain and urgent, regardless of the forecast, if it results from
            an agent off its log keeping its acceleration and heading; twice that in an emergency; 0 for the forecast
            alone.
        planned_motion: whether agents under control are expected on their paths; otherwise they are forecast as other
            agents are.
        unlikely: logarithm of the ratio of probabilities below whose negative a log is unlikely, and its agent taken
            over: a person would not do what it does behind an agent that is elsewhere than recorded; 0 for overlaps
            alone.
        confirm_steps: steps in a row that must predict a conflict before a takeover.
        urgent_time: time to a conflict within which the takeover is immediate.
        held_steps_min: least number of steps for which an agent is held.
        clear_steps: steps in a row without conflict before the hand-back begins, once the goal is passed; twice as
            many before.
        handback: time_shift: to the position of the log that is nearest to the agent, after which the log is replayed
            with that lag; catch_up: to the present position of the log; at_once: likewise, but without a way there:
            the agent is released as soon as it is handed back.
        passing: whether agents behind a permanently slow one pass.
        walkers: whether walkers and cyclists stop before vehicles off their logs that are in their way, and go on
            later, with a lag: with hand-back `time_shift`, and policies that drive them, `litsim` and `yield`.
    """

    horizon: Horizon = 3.0
    margin: Length = 0.0
    probability_threshold: OpenShare = 0.3
    probability_clear: OpenShare = 0.2
    sigma_scale: NonNegative[Number] = 1.0
    braking_time: NonNegative[Duration] = 1.0
    emergency: NonNegative[Acceleration] = 4.5
    roi_m: NonNegative[Length] = 0.0
    approach_time: NonNegative[Duration] = 3.0
    region: Literal["off_log", "ego"] = "off_log"
    baselines: Literal["ego", "conflict", "all"] = "ego"
    closing_time: NonNegative[Duration] = 1.0
    planned_motion: Flag = True
    unlikely: NonNegative[Number] = 3.0
    confirm_steps: Positive[Steps] = 3
    urgent_time: NonNegative[Duration] = 1.0
    held_steps_min: NonNegative[Steps] = 5
    clear_steps: NonNegative[Steps] = 5
    handback: Literal["time_shift", "catch_up", "at_once"] = "time_shift"
    passing: Flag = True
    walkers: Flag = True

    @model_validator(mode="after")
    def _check(self) -> ConflictConfig:
        at_most(self, "probability_clear", "probability_threshold")
        return self
