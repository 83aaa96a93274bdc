"""The rules of giving way and of moving aside against the same said with arrays of everybody."""

import numpy as np
import pytest

from litsim_policy.driving.handback import COMFORTABLE
from litsim_policy.driving.yielding_rules import (
    COURTESY_DECELERATION,
    SIDE_DRIFT,
    SIDE_GAP,
    SIDE_HORIZON,
    SIDE_MARGIN,
    give_way,
    side_is_taken,
)
from litsim_policy.motion.along_path import AlongPath
from litsim_policy.motion.car_following import idm_acceleration
from litsim_sim.core.geometry import to_body
from made_agents import agent_arrays

AGENTS, OTHERS = 6, 14


@pytest.fixture(params=range(12))
def random(request) -> np.random.Generator:
    return np.random.default_rng(request.param)


def test_who_is_in_the_way_is_followed_and_others_are_given_way_to(random) -> None:
    shape = (AGENTS, OTHERS)
    gap, along, aside = (random.normal(*bell, shape) for bell in ((3.0, 6.0), (6.0, 4.0), (0.5, 1.5)))
    ahead, in_path = random.random((2, *shape)) < [[[0.6]], [[0.5]]]
    ids, rows = np.arange(OTHERS) + 20, np.sort(random.permutation(OTHERS)[:AGENTS])
    x, y, yaw = random.normal(0.0, [[5.0], [3.0], [1.0]], (3, OTHERS))
    x[5], y[5] = x[6], y[6]  # neither is ahead of the other
    speed, wanted = random.uniform(0.0, 15.0, (2, AGENTS))
    everybody = np.zeros(OTHERS)
    everybody[rows] = speed
    opponent = random.choice(ids, AGENTS)
    own = np.zeros(AGENTS)
    view = AlongPath(own[:, None] * gap, gap, gap, along, ahead, aside, in_path, np.zeros(AGENTS, np.int64), own, own)
    agents = agent_arrays(OTHERS, id=ids, x=x, y=y, yaw=yaw, speed=everybody)
    found = give_way(view, agents, rows, wanted, opponent, COMFORTABLE.values)
    leads = ahead & in_path & (gap > 0)
    follow = idm_acceleration(COMFORTABLE, speed, wanted, gap, along, leads)
    apart = (x - x[rows, None]) * (np.cos(yaw) + np.cos(yaw[rows, None]))
    apart += (y - y[rows, None]) * (np.sin(yaw) + np.sin(yaw[rows, None]))
    first = (apart > 0) | ((apart == 0) & (ids < ids[rows, None]))
    courted = ahead & (in_path | (ids == opponent[:, None])) & ~leads & ((gap > 0) | first)
    courtesy = idm_acceleration(COMFORTABLE, speed, wanted, gap, along, courted)
    in_the_way = (courted & (aside < 0.0) & (along < speed[:, None])).any(axis=1)
    courtesy = np.where(in_the_way, courtesy, np.maximum(courtesy, -COURTESY_DECELERATION))
    expected = np.where(courted.any(axis=1), np.minimum(follow, courtesy), follow)
    assert (found == expected).all()
    assert courted.any() and leads.any()


def test_the_side_is_taken_by_whoever_is_or_soon_will_be_alongside(random) -> None:
    x, y = random.normal(0.0, [[12.0], [4.0]], (2, OTHERS))
    speed, length, width = random.uniform([[0.0], [3.0], [1.5]], [[15.0], [9.0], [2.5]], (3, OTHERS))
    rows = np.sort(random.permutation(OTHERS)[:AGENTS])
    heading = random.normal(0.0, 0.3, AGENTS)
    target = np.column_stack([x[rows], y[rows]]) + random.normal(0.0, [5.0, 1.0], (AGENTS, 2))
    target[0] = x[rows[0]], y[rows[0]]
    scene = np.sort(random.integers(0, 2, OTHERS))
    agents = agent_arrays(OTHERS, scene=scene, x=x, y=y, speed=speed, length=length, width=width)
    found = side_is_taken(agents, rows, heading, target)
    off_x, off_y = target[:, 0] - x[rows], target[:, 1] - y[rows]
    move = (-np.sin(heading) * off_x + np.cos(heading) * off_y)[:, None]
    ahead, left = to_body(x - x[rows, None], y - y[rows, None], heading[:, None])
    faster = speed - speed[rows, None]
    reach = 0.5 * (length + length[rows, None]) + SIDE_GAP
    reach += np.where(np.sign(ahead) * faster < 0, np.abs(faster) * SIDE_HORIZON, 0.0)
    clearance = np.abs(left) - 0.5 * (width + width[rows, None])
    beside = (np.abs(ahead) < reach) & (left * move > 0) & (clearance < np.abs(move) + SIDE_MARGIN)
    beside &= scene == scene[rows, None]
    beside[np.arange(AGENTS), rows] = False
    expected = (np.abs(move[:, 0]) > SIDE_DRIFT) & beside.any(axis=1)
    assert (found == expected).all()
    assert not found[0]
