"""Pictures of the learning curves of policy C and the learned baselines."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from litsim_sim.io.files import replacing

Lines = Mapping[str, str]
"""The lines of a panel: labels by the names of the history's entries."""

COLUMNS = 3
TRAINING, VALIDATION = "training", "validation"


def _both(name: str) -> Lines:
    """The entry `name` of training and of validation."""
    return {name: TRAINING, f"validation_{name}": VALIDATION}


PANELS: Mapping[str, Lines] = {
    "mean penalty of an agent-step": _both("penalty"),
    "collisions per 1000 agent-steps": _both("collisions"),
    "off the road per 1000 agent-steps": _both("off_road"),
    "critic: accuracy": {"critic_accuracy": TRAINING},
    "critic: mean logit of the policy": {"critic_reward": TRAINING},
    "share of agent-steps that a guard would have changed": _both("guard"),
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
STYLE: Mapping[str, Mapping[str, Any]] = {
    VALIDATION: {"marker": "o", "markersize": 3},
    TRAINING: {"alpha": 0.7, "linewidth": 1.0},
}


def plot_curves(
    history: list[dict[str, float]],
    path: Path,
    panels: Mapping[str, Lines] = PANELS,
    *,
    along: str | None = None,
    log: bool = False,
) -> None:
    """Write a PNG of `history`; a value is drawn for the entries that contain it.

    Args:
        history: one entry per iteration or validation.
        path: of the picture.
        panels: lines that are drawn together, by title.
        along: name of the entry on the horizontal axis; None for the number of the entry.
        log: whether vertical axes are logarithmic.

    Raises:
        Unwritable: the picture cannot be written; what was there is kept.
    """
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    rows = -(-len(panels) // COLUMNS)
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=(13, 3.25 * rows), sharex=True, squeeze=False, layout="constrained"
    )
    for axis, (title, lines) in zip(axes.ravel(), panels.items(), strict=True):
        for name, label in lines.items():
            at = [i for i, entry in enumerate(history) if name in entry]
            counted = at if along is None else [history[i][along] for i in at]
            axis.plot(counted, np.array([history[i][name] for i in at]), label=label, **STYLE.get(label, {}))
        axis.set_title(title, fontsize=10)
        axis.set_yscale("log" if log else "linear")
        axis.grid(alpha=0.3)
        if len(lines) > 1:
            axis.legend(fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("iteration" if along is None else along)
    with replacing(path) as new:
        figure.savefig(new, dpi=110)
    plt.close(figure)
