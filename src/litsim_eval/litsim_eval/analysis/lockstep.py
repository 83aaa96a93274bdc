"""Whether every stage answered every step, and whether the recording is complete."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from litsim_sim.core.errors import INTERRUPTED
from litsim_sim.core.stages import StageState
from litsim_sim.record.run import Run, TopicGaps


@dataclass(frozen=True)
class Lockstep:
    """Completeness of a run.

    Attributes:
        missed: number of steps at which the bridge held the previous answer, by topic.
        gaps: topics with missing, duplicated or unordered steps.
        problems: descriptions of all that makes the run invalid; empty for a valid run.
        port: counts of the ego's messages, see :data:`litsim_sim.ego_port.port.COUNTS`, and their `interface`; empty if
            the ego was not driven over topics.
    """

    missed: dict[str, int]
    gaps: dict[str, TopicGaps]
    problems: tuple[str, ...]
    port: dict[str, Any]


def lockstep(run: Run) -> Lockstep:
    """Check a run for missing answers, gaps in the recording, and an early end."""
    missed = {str(topic): int(n) for topic, n in (run.summary.get("missed") or {}).items()}
    gaps = {topic: found for topic, found in run.gaps.items() if found}
    problems = _problems(run, missed, gaps)
    port = dict(run.summary.get("ego_port") or {})
    if port.get("invalid"):
        problems.append(f"{port['invalid']} answers of the ego could not be used")
    return Lockstep(missed, gaps, tuple(problems), port)


def _problems(run: Run, missed: dict[str, int], gaps: dict[str, TopicGaps]) -> list[str]:
    failed = [(s.stage, s.text.strip()) for s in run.statuses if s.state == StageState.FAILED]
    if run.failure:  # it ended other stages, and may repeat the text of the one that failed
        failed = [(stage, text) for stage, text in failed if text != INTERRUPTED and text not in run.failure]
    problems = [run.failure] if run.failure else []
    problems += [] if run.complete else [f"the recording is {run.problem}"]
    problems += [f"{stage} failed: {text}" for stage, text in failed]
    last = run.tables[-1].step
    if not run.summary:
        problems.append(f"the bridge did not finish: last step {last} of {run.last_step}")
    problems += [f"{n} answers missed on {topic}" for topic, n in sorted(missed.items()) if n]
    problems += [f"{topic}: {describe(found)}" for topic, found in sorted(gaps.items())]
    return problems


def describe(gaps: TopicGaps) -> str:
    """The gaps of a topic as text."""
    kinds = (("missing", gaps.missing), ("duplicated", gaps.duplicated), ("out of order", gaps.unordered))
    return ", ".join(f"{len(steps)} steps {kind} (first {steps[0]})" for kind, steps in kinds if steps)
