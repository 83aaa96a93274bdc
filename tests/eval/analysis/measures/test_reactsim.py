"""ReactSim-Bench's seven measures, each with agents who do what it counts, and with such that nearly do."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.measures.reactsim import reactsim
from litsim_sim.core import steps
from litsim_sim.core.scene import Controller, Kind
from litsim_sim.scenario.scenario import packaged
from made_runs import make_run, table

Make = Callable[..., Any]
NET = packaged("nets/us101_like.net.xml").read_bytes()
EGO, OTHER, THIRD = 1, 2, 3
LANE = -1.83  # [m]
STEPS = 41


@pytest.fixture
def measured() -> Callable[..., Any]:
    """The measures of a run in which agents are as functions of the step say; nobody is in the log."""

    def measure(*agents: Callable[[int], dict[str, Any]], net: bytes = NET) -> Any:
        def row(agent: int, of_step: dict[str, Any]) -> dict[str, Any]:
            return {"id": agent, "y": LANE, "controller": Controller.EGO if agent == EGO else Controller.LOG} | of_step

        tables = [table(k, *(row(i, agent(k)) for i, agent in enumerate(agents, EGO))) for k in range(STEPS)]
        run = make_run(tables, [table(k) for k in range(STEPS)], net_xml=net)
        return reactsim(run)

    return measure


def ahead(k: int) -> dict[str, Any]:
    """An ego at 5 m/s."""
    return {"x": 60.0 + 0.5 * k, "speed": 5.0}


def behind(gap: float, speed: float, **values: Any) -> Callable[[int], dict[str, Any]]:
    """An agent that is `gap` behind :func:`ahead`, bumper to bumper, at first."""
    return lambda k: {"x": 56.0 - gap + 0.1 * speed * k, "speed": speed} | values


@pytest.mark.parametrize(
    ("other", "contacts", "short"),
    [
        (behind(8.0, 10.0), 1, 1),
        (behind(12.0, 7.0), 0, 0),
        (behind(8.0, 10.0, y=LANE + 3.66), 0, 0),
        (behind(8.0, 10.0, kind=Kind.PEDESTRIAN), 0, 0),
        (behind(-18.0, 0.0), 0, 1),
        (behind(-12.0, 3.0), 0, 1),
    ],
    ids=["hits from behind", "stays behind", "passes beside", "walks", "is stood", "is hit from behind"],
)
def test_contacts_count_where_the_agent_is_at_fault(measured: Make, other: Any, contacts: int, short: int) -> None:
    found = measured(ahead, other)
    assert (found["ego_contacts"], found["ego_short_ttc"]) == (contacts, short)


def test_a_near_miss_is_short_of_time_and_no_contact(measured: Make) -> None:
    """Faster by 10 m/s, it brakes to the ego's speed once 4 m are left, which are 0.4 s."""
    near = measured(ahead, lambda k: {"x": 56.0 + 0.5 * k - max(4.0, 24.0 - k), "speed": 15.0 if k <= 20 else 5.0})
    assert (near["ego_contacts"], near["ego_short_ttc"]) == (0, 1)


def test_contacts_among_others_are_a_share_of_their_steps(measured: Make) -> None:
    """One of two stands inside the other at half of the 40 steps."""
    found = measured(ahead, lambda _: {"x": 10.0}, lambda k: {"x": 12.0 if k > 20 else 20.0})
    assert (found["contact_share"], found["ego_contacts"]) == (0.5, 0)


def test_off_the_road_counts_for_who_was_on_it(measured: Make) -> None:
    leaving = measured(ahead, lambda k: {"x": k, "y": LANE if k <= 20 else 30.0})
    never_on = measured(ahead, lambda k: {"x": k, "y": LANE}, lambda k: {"x": k, "y": 30.0})
    assert leaving["off_road"] == pytest.approx(0.5) and never_on["off_road"] == 0.0
    assert measured(ahead, lambda k: {"x": k, "y": 30.0}, net=b"")["off_road"] is None


def test_against_the_traffic_counts_once_it_lasts(measured: Make) -> None:
    def back(k: int, since: int = 0, **values: Any) -> dict[str, Any]:
        return {"x": 60.0 - max(k - since, 0), "y": LANE, "yaw": np.pi} | values

    assert measured(ahead, back, lambda k: {"x": k})["wrong_way"] == 0.5
    assert measured(ahead, lambda k: back(k, yaw=0.0), lambda k: {"x": k})["wrong_way"] == 0.0, "it only reverses"
    assert measured(ahead, lambda k: back(k, since=33), lambda k: {"x": k})["wrong_way"] == 0.0, "it has just begun"


@pytest.mark.parametrize(("rate", "share"), [(5.9, 0.0), (6.5, 1.0), (-6.5, 1.0)])
def test_accelerations_beyond_what_vehicles_can(measured: Make, rate: float, share: float) -> None:
    found = measured(ahead, lambda k: {"x": k, "speed": 30.0 + 0.1 * rate * k})
    assert (found["acceleration_infeasible"], found["curvature_infeasible"]) == (share, 0.0)


@pytest.mark.parametrize(("speed", "share"), [(0.5, 0.0), (1.0, 1.0), (2.0, 0.0)])
def test_turns_tighter_than_vehicles_can_but_at_rest(measured: Make, speed: float, share: float) -> None:
    """By 0.4 rad/s: a radius of 2.5 m at 1 m/s, of 5 m at 2 m/s."""
    found = measured(ahead, lambda k: {"x": 0.1 * speed * k, "speed": speed, "yaw": 0.04 * k})
    assert found["curvature_infeasible"] == pytest.approx(share)


def test_blocks_of_steps_count_everything_once(measured: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    agents = (
        ahead,
        behind(8.0, 10.0),
        lambda k: {"x": 60.0 - k, "y": LANE - 3.66, "yaw": np.pi},
        lambda k: {"x": 200.0 + k, "speed": 10.0 + 0.8 * (k % 7)},
    )
    whole = measured(*agents)
    monkeypatch.setattr(steps, "BLOCK_ROWS", 9)
    assert measured(*agents) == whole and 0.0 < whole["acceleration_infeasible"] < 1.0
