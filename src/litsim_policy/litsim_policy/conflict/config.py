"""Parameters of conflict detection."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from litsim_policy.conflict.intended import IntentConfig
from litsim_sim.core.quantities import (
    Acceleration,
    Duration,
    Horizon,
    Length,
    NonNegative,
    Number,
    OpenShare,
    at_most,
    configuration,
)


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
    intent: IntentConfig = IntentConfig()
    happened: str = ""

    @model_validator(mode="after")
    def _check(self) -> ConflictConfig:
        at_most(self, "probability_clear", "probability_threshold")
        return self
