"""How often the safety layer of the policy changed what the policy wanted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import ControlSource
from litsim_sim.record.run import Run


@dataclass(frozen=True)
class Guarded:
    """Commands of the policy over the steps after the history, one an agent and step.

    Attributes:
        commands: that a policy drove an agent by: POLICY or GUARDED. Those of hand-backs and baselines have no guard.
        changed: of these, which a guard changed: GUARDED.
    """

    commands: int
    changed: int

    @property
    def share(self) -> float | None:
        """Share of the commands that were changed, from 0 to 1; None where there were no commands."""
        return self.changed / self.commands if self.commands else None


def guarded(run: Run) -> Guarded:
    """Guarded commands among those that moved somebody: the answers to all steps but the last."""
    last = run.tables[-1].step
    answers = [c.source for step, c in run.controls.items() if run.info.history_steps <= step < last]
    source = np.concatenate(answers) if answers else np.empty(0, np.uint8)
    changed = int(np.sum(source == ControlSource.GUARDED))
    return Guarded(changed + int(np.sum(source == ControlSource.POLICY)), changed)
