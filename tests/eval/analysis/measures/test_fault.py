"""Contacts by fault, with the careful driver in either place."""

from pathlib import Path
from typing import Any

import pytest

import litsim_sim
from litsim_eval.analysis.measures.fault import contact_verdicts, count_faults
from litsim_sim.core.scene import Kind
from made_runs import make_run, table

NET = Path(litsim_sim.__file__).parent / "nets/us101_like.net.xml"
LANES = (-1.83, -5.49)  # [m] centres of the leftmost lanes of us101_like
STEPS = 100


def drift(behind: float, faster: float, rate: float, **more: Any) -> Any:
    """Ego 1 leaves its lane to the right, by `rate` [m] a step from step 20 on, before agent 2 in that lane.

    Agent 2 has its centre `behind` [m] the ego's, drives `faster` [m/s], and does not react. In the log the ego stays.
    """
    log, tables = [], []
    for k in range(STEPS + 1):
        ego = {"id": 1, "x": 100.0 + 1.0 * k, "y": LANES[0], "speed": 10.0}
        other = {"id": 2, "x": 100.0 - behind + (1.0 + 0.1 * faster) * k, "y": LANES[1], "speed": 10.0 + faster, **more}
        log.append(table(k, ego, other))
        tables.append(table(k, ego | {"y": max(LANES[1], LANES[0] - rate * max(0, k - 20))}, other))
    return make_run(tables, log, history_steps=0, net_xml=NET.read_bytes())


def faults(run: Any) -> tuple[int, ...]:
    """Contacts at the fault of the background, and at the ego's that the other could and could not have avoided."""
    return tuple(count_faults(run).values())


def test_a_cut_in_that_announces_itself_is_one_that_the_other_could_have_avoided() -> None:
    run = drift(behind=20.0, faster=4.0, rate=0.08)
    (found,) = contact_verdicts(run)
    assert found.contact.ego_at_fault and not found.in_log
    assert found.other is not None and found.other.avoided
    assert 20 < found.other.perceived_step < found.contact.step - 10, "the ego's wandering is seen long before"
    assert faults(run) == (0, 1, 0)


def test_whoever_is_beside_when_the_ego_jumps_over_cannot_help_it() -> None:
    run = drift(behind=0.0, faster=0.0, rate=0.5)
    (found,) = contact_verdicts(run)
    assert found.contact.ego_at_fault
    assert found.other is not None and not found.other.avoided
    assert faults(run) == (0, 0, 1)


def test_nobody_drives_in_the_place_of_a_pedestrian() -> None:
    run = drift(behind=20.0, faster=4.0, rate=0.08, kind=Kind.PEDESTRIAN)
    (found,) = contact_verdicts(run)
    assert found.other is None
    assert faults(run) == (0, 0, 1)


@pytest.mark.parametrize("logged", [False, True])
def test_running_into_others_is_the_background_s_fault_unless_the_log_has_it(logged: bool) -> None:
    """Agent 2 runs into the ego from behind, and agent 3 into agent 4."""
    apart = {1: (100.0, 1.0), 2: (70.0, 1.5), 3: (170.0, 1.5), 4: (200.0, 1.0)}
    tables = [
        table(k, *({"id": a, "x": x + v * k, "y": LANES[0], "speed": 10.0 * v} for a, (x, v) in apart.items()))
        for k in range(58)
    ]
    still = [
        table(k, *({"id": a, "x": x + k, "y": LANES[0], "speed": 10.0} for a, (x, _) in apart.items()))
        for k in range(58)
    ]
    run = make_run(tables, tables if logged else still, history_steps=0, net_xml=NET.read_bytes())
    assert faults(run) == ((0, 0, 0) if logged else (2, 0, 0))
