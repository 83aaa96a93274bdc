"""Whether every stage answered every step, and whether the record holds it."""

from __future__ import annotations

from dataclasses import dataclass

from litsim_sim.analysis.run import Run, StageState, TopicGaps


@dataclass(frozen=True)
class Lockstep:
    """Completeness of a run.

    Attributes:
        missed: number of steps at which the bridge held an answer of before, by topic.
        gaps: topics with missing, duplicated or unordered steps.
        problems: everything that makes the run invalid, in words; empty for a valid one.
    """

    missed: dict[str, int]
    gaps: dict[str, TopicGaps]
    problems: tuple[str, ...]


def lockstep(run: Run) -> Lockstep:
    """Check a run for missing answers, gaps in the record, and its end."""
    missed = {str(topic): int(n) for topic, n in (run.summary.get("missed") or {}).items()}
    gaps = {topic: found for topic, found in run.gaps.items() if found}
    return Lockstep(missed, gaps, tuple(_problems(run, missed, gaps)))


def _problems(run: Run, missed: dict[str, int], gaps: dict[str, TopicGaps]) -> list[str]:
    problems = [] if run.complete else [f"the recording is {run.problem}"]
    problems += [f"{s.stage} failed: {s.text.strip()}" for s in run.statuses if s.state == StageState.FAILED]
    last = run.tables[-1].step
    if not run.summary:
        problems.append(f"the bridge did not finish: last step {last} of {run.info.total_steps}")
    problems += [f"{n} answers missed on {topic}" for topic, n in sorted(missed.items()) if n]
    problems += [f"{topic}: {describe(found)}" for topic, found in sorted(gaps.items())]
    return problems


def describe(gaps: TopicGaps) -> str:
    """A topic's gaps in words."""
    kinds = (("missing", gaps.missing), ("duplicated", gaps.duplicated), ("out of order", gaps.unordered))
    return ", ".join(f"{len(steps)} steps {kind} (first {steps[0]})" for kind, steps in kinds if steps)
