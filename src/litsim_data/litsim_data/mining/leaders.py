"""Leaders of all agents along lanes, at every step of a log."""

from __future__ import annotations

import numpy as np

from litsim_data.mining.lane_tracks import NOWHERE, LaneTracks
from litsim_data.surrogates.safety import SIGHT_M, Following
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log

HOPS_MAX = 64  # most lanes searched ahead; more than fit into 100 m


def leaders(log: Log, tracks: LaneTracks, lane_map: LaneMap) -> Following:
    """Returns leaders of all agents at all steps, and how they are followed; arrays (n, steps), `leader` as rows of
    the log.

    The leader is the nearest agent ahead within 100 m with its centre in the same lane, or in the lanes that the agent
    takes next (as recorded; beyond its log the straightest). The gap is measured along the lanes from bumper to bumper;
    0 if the boxes overlap along the lane.
    """
    shape = log.valid.shape
    leader, distance = np.full(shape, NOWHERE), np.full(shape, np.inf)
    agent, step = np.nonzero(tracks.lane != NOWHERE)
    lane, s = tracks.lane[agent, step], tracks.s[agent, step]
    order = np.lexsort((agent, s, lane, step))
    agent, step, lane, s = agent[order], step[order], lane[order], s[order]
    same = (step[1:] == step[:-1]) & (lane[1:] == lane[:-1])
    leader[agent[:-1][same], step[:-1][same]] = agent[1:][same]
    distance[agent[:-1][same], step[:-1][same]] = (s[1:] - s[:-1])[same]

    first = np.concatenate([[True], ~same])[: len(agent)]
    nearest = np.full((shape[1], len(lane_map.lanes)), NOWHERE)  # rearmost agent of each lane
    nearest[step[first], lane[first]] = agent[first]
    _look_ahead(tracks, lane_map, SIGHT_M + log.length.max(initial=0.0), nearest, leader, distance)
    return _followed(log, tracks.along, leader, distance)


def _look_ahead(
    tracks: LaneTracks, lane_map: LaneMap, reach: float, nearest: IntArray, leader: IntArray, distance: FloatArray
) -> None:
    """Fills `leader` and `distance` (n, steps) for the foremost agents of each lane, from the lanes that follow.

    Those that begin farther away than `reach` [m] are left out.
    """
    length = np.array([lane.length for lane in lane_map.lanes])
    agent, step = np.nonzero((tracks.lane != NOWHERE) & (leader == NOWHERE))
    lane = tracks.lane[agent, step]
    way = length[lane] - tracks.s[agent, step]
    for _ in range(HOPS_MAX):
        lane = tracks.following[agent, lane]
        going: BoolArray = (lane != NOWHERE) & (way < reach)
        agent, step, lane, way = agent[going], step[going], lane[going], way[going]
        if not len(agent):
            return
        ahead = nearest[step, lane]
        has_leader = (ahead != NOWHERE) & (ahead != agent)
        leader[agent[has_leader], step[has_leader]] = ahead[has_leader]
        distance[agent[has_leader], step[has_leader]] = (way + tracks.s[ahead, step])[has_leader]
        agent, step, lane, way = (
            agent[~has_leader],
            step[~has_leader],
            lane[~has_leader],
            (way + length[lane])[~has_leader],
        )


def _followed(log: Log, along: FloatArray, leader: IntArray, distance: FloatArray) -> Following:
    """Returns measures from speeds `along` lanes [m/s], leaders, and distances to their centres [m]; all (n, steps)."""
    steps = np.arange(leader.shape[1])
    gap = distance - 0.5 * (log.length[:, None] + log.length[leader])
    leader = np.where(gap < SIGHT_M, leader, NOWHERE)
    there = leader != NOWHERE
    closing = np.where(there, along - along[leader, steps], 0.0)
    return Following.measured(leader, np.where(there, np.maximum(gap, 0.0), np.inf), closing, log.speed)
