"""Whether every stage answered every step, whether the recording is complete, and what makes a run invalid."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import ANY_KEY, HIGHER, LOWER, Branch, Count, Measure, Text, Truth, family
from litsim_eval.analysis.measures.identity import digest
from litsim_sim.core.errors import INTERRUPTED, printable
from litsim_sim.core.lockstep import unanswered
from litsim_sim.core.scene import ARRAY_FIELDS
from litsim_sim.core.stages import BRIDGE, StageState
from litsim_sim.core.topic_names import STATUS
from litsim_sim.ego_port.port import COUNTS
from litsim_sim.record.run import Run, TopicGaps


@Branch
def lockstep(run: Run) -> dict[str, Any]:
    """Returns missing answers, gaps in the recording, and counts of the ego's messages.

    `ego_port` holds :data:`litsim_sim.ego_port.port.COUNTS` and the `interface`; it is empty if the ego was not driven
    over topics.
    """
    missed = {str(topic): int(n) for topic, n in (run.summary.get("missed") or {}).items()}  # answers held, by topic
    return {
        "missed": sum(missed.values()),
        "gaps": sum(len(gap.missing) + len(gap.duplicated) + len(gap.unordered) for gap in run.gaps.values()),
        "missed_by_topic": missed,
        "ego_port": dict(run.summary.get("ego_port") or {}),
    }


def problems(run: Run) -> list[str]:
    """Returns all that makes a run invalid, in words; empty for a valid run.

    Of a run that did not finish, the steps from its last on are not named as missing.
    """
    end = run.last_step + 1 if run.summary else run.tables[-1].step
    within = {
        topic: replace(gaps, missing=tuple(k for k in gaps.missing if k < end)) for topic, gaps in run.gaps.items()
    }
    gaps = (f"{topic}: {_described(gaps)}" for topic, gaps in sorted(within.items()) if gaps)
    not_as_sealed = [] if run.seal is None else run.seal.flaws(run.facts(run.once(digest)))
    return [*_failures(run), *unanswered(run.summary), *gaps, *_unusable(run), *not_as_sealed]


def _failures(run: Run) -> list[str]:
    failed = [(s.stage, printable(s.text.strip())) for s in run.statuses if s.state == StageState.FAILED]
    if run.failure:  # it ended other stages, and may repeat the text of the one that failed
        failed = [(stage, text) for stage, text in failed if text != INTERRUPTED and text not in run.failure]
    texts = [run.failure] if run.failure else []
    texts += [] if run.complete else [f"the recording is {run.problem}"]
    texts += [f"{stage} failed: {text}" for stage, text in failed]
    if len({s.text for s in run.statuses if (s.stage, s.state) == (BRIDGE, StageState.FINISHED)}) > 1:
        texts.append(f"{STATUS} has two different last messages of the bridge, so somebody else publishes there")
    if not run.summary:
        texts.append(f"the bridge did not finish: last step {run.tables[-1].step} of {run.last_step}")
    return texts


def _unusable(run: Run) -> list[str]:
    texts = [] if run.log else ["the bag holds no recording to compare with"]
    bad: list[int] = []
    for part in run.steps.parts():
        table = part.stacked
        finite = np.logical_and.reduce([np.isfinite(getattr(table, field)) for field in ARRAY_FIELDS])
        bad += part.step[np.unique(table.number[~finite])].tolist()
    if bad:
        texts.append(f"agent states are not finite at {len(bad)} steps (first {bad[0]})")
    return texts


def _described(gaps: TopicGaps) -> str:
    kinds = (("missing", gaps.missing), ("duplicated", gaps.duplicated), ("out of order", gaps.unordered))
    return ", ".join(f"{len(steps)} steps {kind} (first {steps[0]})" for kind, steps in kinds if steps)


MEASURES = family(
    "missed answers; steps that are missing in the record, there twice or out of order; missed answers by topic",
    Count("lockstep.missed", lockstep, better=LOWER),
    Count("lockstep.gaps", lockstep, better=LOWER),
    Count("lockstep.missed_by_topic", lockstep, keys=(ANY_KEY,)),
    "counts of the ego's messages by outcome ([terms](ego-interface.md#what-goes-wrong))",
    Measure("lockstep.ego_port", lockstep, kinds=(int, str), keys=(*COUNTS, "interface")),
)
VALIDITY = family(
    "false where a stage failed, or an answer or a step is missing; and why",
    Truth("valid", lambda run: not run.once(problems), better=HIGHER),
    Text("why", lambda run: "; ".join(run.once(problems))),
)
