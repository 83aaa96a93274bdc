"""How often the safety layer of the policy changed a command."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import ControlSource
from litsim_sim.record.run import Run


@dataclass(frozen=True)
class Guarded:
    """Numbers of policy commands over the steps after the history, one per agent and step.

    Attributes:
        commands: commands with source POLICY or GUARDED; hand-backs and baselines have no guard.
        changed: those with source GUARDED.
    """

    commands: int
    changed: int

    @property
    def share(self) -> float | None:
        """Share of changed commands, from 0 to 1; None without commands."""
        return self.changed / self.commands if self.commands else None


def guarded(run: Run) -> Guarded:
    """Count the commands that were applied: the answers to all steps but the last."""
    last = run.tables[-1].step
    answers = [c.source for step, c in run.controls.items() if run.info.history_steps <= step < last]
    source = np.concatenate(answers) if answers else np.empty(0, np.uint8)
    changed = int(np.sum(source == ControlSource.GUARDED))
    return Guarded(changed + int(np.sum(source == ControlSource.POLICY)), changed)
