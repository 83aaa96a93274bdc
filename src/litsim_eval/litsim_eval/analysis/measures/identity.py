"""Which run it is, who is in it, and how it ended."""

from __future__ import annotations

from litsim_eval.analysis.measure import SUM, Count, Listed, Measure, Text, family
from litsim_eval.analysis.measures.collision import collisions
from litsim_sim.record.digest import RunDigest
from litsim_sim.record.run import Run


def digest(run: Run) -> str:
    """Returns the digest of a run; equals that of an equal run in process."""
    total = RunDigest()
    for table in run.tables:
        total.update(table, run.controls.get(table.step), run.ego_commands.get(table.step))
    return total.hexdigest()


MEASURES = family(
    "of the run ([run id](recording.md#what-is-there))",
    Text("run_id", lambda run: run.info.run_id),
    Text("scenario", lambda run: run.info.scenario),
    Text("ego", lambda run: run.info.ego),
    Text("policy", lambda run: run.info.policy),
    Count("seed", lambda run: run.info.seed),
    "last step in the record; of the scenario",
    Count("steps", lambda run: run.tables[-1].step),
    Count("total_steps", lambda run: run.info.total_steps),
    "[why and when the run ended](#the-end-of-a-run); null if the record does not say",
    Text("ended.reason", lambda run: None if run.ended is None else str(run.ended.reason)),
    Count("ended.step", lambda run: None if run.ended is None else run.ended.step),
    Measure(
        "ended.time_s", lambda run: None if run.ended is None else round(run.ended.step * run.info.dt, 6), unit="s"
    ),
    Text("ended.lane", lambda run: None if run.ended is None else run.ended.lane),
    "background agents that appear; those that were ever under control",
    Count("agents", lambda run: len(run.once(collisions).agents - {run.info.ego_id}), "agents", rows=SUM),
    Count("controlled_agents", lambda run: len(run.once(collisions).controlled), "agents ever under control"),
    "equal for [equal runs](faults.md#digests)",
    Text("digest", lambda run: run.once(digest)),
    "[the seal](faults.md#the-seal) of the record, and by whose key; null without a record",
    Text("seal", lambda run: None if run.seal is None else run.seal.signature),
)
WORLD = family(
    "agents that entered late and that never entered",
    Listed("world.late_entries", lambda run: run.summary.get("late_entries")),
    Listed("world.never_entered", lambda run: run.summary.get("never_entered")),
    "largest distance between a front centre in SUMO and in the world, every tenth step; null without SUMO",
    Measure("world.sumo_deviation_m", lambda run: run.summary.get("sumo_deviation_m"), unit="m"),
)
