"""Learning curves of policy C and of the baselines that learn, as pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

PANELS = {
    "mean penalty of an agent-step": ("penalty", "validation_penalty"),
    "collisions per 1000 agent-steps": ("collisions", "validation_collisions"),
    "off the road per 1000 agent-steps": ("off_road", "validation_off_road"),
    "critic: share told right": ("critic_accuracy",),
    "critic: mean logit of the policy": ("critic_reward",),
    "share of agent-steps that a guard would have changed": ("guard", "validation_guard"),
}
IMITATION_PANELS = {
    "share of agents that touched somebody": ("contact", "validation_contact"),
    "share of agents that left the road": ("off_road", "validation_off_road"),
    "error at the end of an episode [m]": ("error", "validation_error"),
    "critic: distance of the sides": ("critic_distance",),
    "what RAIL punishes, mean of a step": ("fault",),
    "deviation of the actions": ("deviation",),
}
STYLE: dict[str, dict[str, Any]] = {
    "validation": {"marker": "o", "markersize": 3},
    "training": {"alpha": 0.7, "linewidth": 1.0},
}


def plot_curves(history: list[dict[str, float]], path: Path, panels: Mapping[str, tuple[str, ...]] = PANELS) -> None:
    """Write a PNG of `history`, one entry an iteration; validations are among them where they were made.

    `panels` (six) say which entries are drawn together under which title.
    """
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(13, 6.5), sharex=True, layout="constrained")
    for axis, (title, names) in zip(axes.ravel(), panels.items(), strict=True):
        for name in names:
            at = [i for i, entry in enumerate(history) if name in entry]
            kind = "validation" if name.startswith("validation") else "training"
            axis.plot(at, np.array([history[i][name] for i in at]), label=kind, **STYLE[kind])
        axis.set_title(title, fontsize=10)
        axis.grid(alpha=0.3)
        if len(names) > 1:
            axis.legend(fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("iteration")
    figure.savefig(path, dpi=110)
    plt.close(figure)
