"""Progress: distances travelled by the agents, and whether they stay on the road."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import shapely

from litsim_eval.analysis.measure import LOWER, MEAN, Measure, Row, Share, Table, family, largest, mean
from litsim_eval.analysis.measures.collision import collisions
from litsim_eval.analysis.measures.displacement import displacements
from litsim_sim.core.scene import AgentTable, FloatArray
from litsim_sim.core.steps import Steps
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

ON_WAY = 1.0  # [m] beside the recorded way of an agent up to which it is on its road, where the map has ended


def distance_of(tables: Sequence[AgentTable], agent: int, last: int | None = None) -> float | None:
    """Returns the distance [m] that an agent travels between consecutive steps; None if it is never on the road.

    Only steps up to `last` count, if given.
    """
    steps = Steps.of(tables)
    rows, table = steps.track(agent), steps.stacked
    rows = rows if last is None else rows[steps.step[table.number[rows]] <= last]
    follows = np.diff(table.number[rows]) == 1
    parts = np.hypot(np.diff(table.x[rows]), np.diff(table.y[rows]))[follows]
    return float(np.append(0.0, parts).cumsum()[-1]) if len(rows) else None  # in order: rounding is reproducible


def mean_progress(
    tables: Sequence[AgentTable], log: Sequence[AgentTable], agents: Collection[int] | None = None
) -> float | None:
    """Returns the mean distance [m] travelled by the agents of `log`, or by those in `agents`; None without agents.

    Only the time in which its log has an agent on the road counts. An agent that is not on the road then, such as one
    held back at its entry, makes no progress. `tables` and `log` are the same consecutive steps.
    """
    logged = Steps.of(log)
    length = Steps.of(tables).once(_lengths, logged)
    if agents is not None:
        length = length[np.isin(logged.ids, list(agents))]
    return float(np.mean(length)) if len(length) else None


def _lengths(steps: Steps, log: Steps) -> FloatArray:
    """Returns the distance (n,) [m] travelled by each agent of `log`; see :func:`mean_progress`."""
    total = np.zeros(len(log.ids))
    for begin, end in log.blocks():
        part, then = (tables.part(max(0, begin - 1), end) for tables in (steps, log))
        table, number, ids = part.stacked, then.stacked.number, then.stacked.id
        rows, before = (part.rows_at(number - back, ids) for back in (0, 1))
        counts = (rows >= 0) & (before >= 0) & (then.rows_at(number - 1, ids) >= 0)
        now, before = rows[counts], before[counts]
        parts = np.hypot(table.x[now] - table.x[before], table.y[now] - table.y[before])
        np.add.at(total, log.ids.searchsorted(ids[counts]), parts)  # in order of the steps, too
    return total


def _off_road_controlled(run: Run) -> float | None:
    """Returns the share of vehicles' steps under control off the road; None without any such step, or a net."""
    lane_map = lane_map_of(run)
    if lane_map is None:
        return None
    driven, off_lanes = 0, dict[int, list[FloatArray]]()
    for part in run.simulated.parts():
        table = part.stacked
        rows = (table.of_policy & ~table.obstacle).nonzero()[0]
        driven, rows = driven + len(rows), rows[~lane_map.inside_road(table.x[rows], table.y[rows])]
        for agent in np.unique(table.id[rows]).tolist():
            own = rows[table.id[rows] == agent]
            off_lanes.setdefault(agent, []).append(np.stack([table.x[own], table.y[own]]))
    places = {agent: np.concatenate(parts, axis=1) for agent, parts in off_lanes.items()}
    off_road = sum(int(np.sum(beside_logged_way(run.logged, agent, x, y) > ON_WAY)) for agent, (x, y) in places.items())
    return off_road / driven if driven else None


def beside_logged_way(log: Steps, agent: int, x: FloatArray, y: FloatArray) -> FloatArray:
    """Returns how far points (n,) [m] are from the way (n,) [m] that `agent` takes in the log."""
    tracks = [(part.stacked, part.track(agent)) for part in log.parts()]
    way = np.concatenate([np.column_stack([table.x[rows], table.y[rows]]) for table, rows in tracks])
    return np.asarray(shapely.distance(shapely.points(x, y), shapely.linestrings(np.append(way, way[-1:], axis=0))))


def _driven(run: Run, agents: Collection[int] | None = None) -> float | None:
    """Returns :func:`mean_progress` after the history."""
    last = run.info.history_steps - 1
    return mean_progress(run.steps.after(last), run.logged.after(last), agents)


def _logged(run: Run) -> float | None:
    logged = run.logged.after(run.info.history_steps - 1)
    return mean_progress(logged, logged)


def _replay_error(run: Run) -> float | None:
    return max(run.once(displacements).replay_error().values(), default=None)


OFF_ROAD, LARGEST = (Row("off_road", mean, of_control=True),), (Row(over=largest, table=Table.NONE),)
MEASURES = family(
    "share of the steps of vehicles under control at which the box centre is on no lane, and more than 1 m beside the "
    "way that the vehicle takes in the log, which is its road where the map ends; `null` if there are none",
    Share("off_road_controlled", _off_road_controlled, "off road, controlled", "", LOWER, rows=OFF_ROAD),
    "largest displacement of an agent that was never under control",
    Measure("replay_error_max_m", _replay_error, "", "m", LOWER, rows=LARGEST),
    "mean distance that the agents of the log travel after the history; those ever under control; the log's own. Only "
    "steps within the agent's log count",
    Measure("progress_m", _driven, "progress of all agents", "m", rows=MEAN),
    Measure("progress_controlled_m", lambda run: _driven(run, run.once(collisions).controlled), unit="m"),
    Measure("progress_log_m", _logged, "progress of all agents in the log", "m"),
)
