"""How an agent is taken over: for which reason, against whom, and on which path."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from litsim_policy.conflict.detector import Conflict
from litsim_policy.conflict.diverged import DivergedAgents
from litsim_policy.motion.reference_path import logged_path, route_path
from litsim_policy.motion.route import Router
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray
from litsim_sim.core.takeover import PathSource, TakeoverReason
from litsim_sim.scenario.setting import Setting


def by_conflict(scenario: Setting, router: Router, table: AgentTable, conflict: Conflict) -> DivergedAgents:
    """Returns the agent of `conflict`, on a route to the crossing point.

    It keeps to its logged path if there is no such route, or if only its log has become unlikely.
    """
    row, logged = table.row(conflict.agent), logged_path(scenario.log, scenario.lane_map, conflict.agent)
    crosses = conflict.reason == TakeoverReason.CONFLICT
    route = router.path(_pose(table, row), float(table.speed[row]), conflict.pose) if crosses else None
    path, source = (logged, PathSource.LOGGED) if route is None else (route.followed_by(logged), PathSource.ROUTE)
    return DivergedAgents.opened(
        conflict.agent,
        conflict.opponent,
        table.step,
        conflict.reason,
        conflict.pose,
        (path, source, logged),
        time_to_conflict=conflict.time_to_conflict,
        overlap_probability=conflict.overlap_probability,
    )


def by_late_entry(scenario: Setting, table: AgentTable, diverged: BoolArray) -> Iterator[DivergedAgents]:
    """Yields each agent that has entered late, because its log began where the road was not free, on its logged path.

    Its opponent is the nearest agent off its log (mask `diverged`), including those that entered late before it.
    """
    rows = (table.of_policy & ~diverged).nonzero()[0]
    diverged = diverged.copy()
    for row in rows.tolist():
        others = (diverged & (table.scene == table.scene[row])).nonzero()[0]
        distance = np.hypot(table.x[others] - table.x[row], table.y[others] - table.y[row])
        nearest = others[distance.argmin()] if len(others) else row
        agent, opponent, goal = int(table.id[row]), int(table.id[nearest]), _pose(table, row)
        logged = logged_path(scenario.log, scenario.lane_map, agent)
        reason, paths = TakeoverReason.BLOCKED_ENTRY, (logged, PathSource.LOGGED, logged)
        yield DivergedAgents.opened(agent, opponent, table.step, reason, goal, paths, overlap_probability=1.0)
        diverged[row] = True


def by_region(scenario: Setting, table: AgentTable, row: int, reason: TakeoverReason) -> DivergedAgents:
    """Returns the agent in `row`, on its lane along the route of its log; it is in no conflict."""
    agent, ego, pose = int(table.id[row]), int(scenario.ego_ids[table.scene[row]]), _pose(table, row)
    path = route_path(scenario.log, scenario.lane_map, agent, pose)
    paths = path, PathSource.LANE, logged_path(scenario.log, scenario.lane_map, agent)
    return DivergedAgents.opened(agent, ego, table.step, reason, pose, paths, in_conflict=False)


def _pose(table: AgentTable, row: int) -> FloatArray:
    """Returns the pose (3,) x, y [m], yaw [rad] of the agent in `row`."""
    return np.array([table.x[row], table.y[row], table.yaw[row]])
