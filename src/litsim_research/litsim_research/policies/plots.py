"""Panels of the learning curves of policy C and the learned baselines."""

from __future__ import annotations

from collections.abc import Mapping

from litsim_research.predictors.training.curves import TRAINING, VALIDATION, Lines


def _both(name: str) -> Lines:
    """The entry `name` of training and of validation."""
    return {name: TRAINING, f"validation_{name}": VALIDATION}


PANELS: Mapping[str, Lines] = {
    "mean penalty of an agent-step": _both("penalty"),
    "collisions per 1000 agent-steps": _both("collisions"),
    "off the road per 1000 agent-steps": _both("off_road"),
    "critic: accuracy": {"critic_accuracy": TRAINING},
    "critic: mean logit of the policy": {"critic_reward": TRAINING},
    "share of steps that the guard would change": _both("guard"),
    "growth of the distance from the log [m]": {"displacement": TRAINING},
    "hard braking, mean per step": _both("hard_brake"),
}
IMITATION_PANELS: Mapping[str, Lines] = {
    "share of agents with a contact": _both("contact"),
    "share of agents that left the road": _both("off_road"),
    "error at the end of an episode [m]": _both("error"),
    "critic: distance of expert and policy": {"critic_distance": TRAINING},
    "RAIL's penalty, mean per step": {"fault": TRAINING},
    "standard deviation of the actions": {"deviation": TRAINING},
}
SIMNET_PANELS: Mapping[str, Lines] = {
    "mean squared error, normalised": {"training": TRAINING, "validation": VALIDATION},
    "first step, RMSE": {"ahead_first": "ahead [m]", "turn_first": "turn [rad]"},
    "after 1.2 s, mean distance [m]": {"away_last": VALIDATION},
}
