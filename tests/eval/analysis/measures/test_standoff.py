"""Who stands for whom, since when, and who could go first."""

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.measures.standoff import standoffs
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.signal_links import SignalLink
from litsim_sim.scenario.signals import Signals
from made_runs import make_run, table

STEPS, BEGIN, END = 80, 10, 60
UP = 0.5 * np.pi


def made(place: tuple[float, float], yaw: float = UP, end: int = END, **fields: Any) -> Any:
    """The ego stands at the origin from BEGIN on, and another at a `place` until `end`; their logs go on."""
    along = np.array([np.cos(yaw), np.sin(yaw)])

    def both(step: int, ego: float, other: float, stand: tuple[bool, bool]) -> Any:
        x, y = place + along * other
        speeds = [0.0 if stands else 10.0 for stands in stand]
        return table(
            step,
            {"id": 1, "x": ego, "y": 0.0, "speed": speeds[0]},
            {"id": 2, "x": x, "y": y, "yaw": yaw, "speed": speeds[1]},
        )

    driven = [
        both(k, min(k - BEGIN, 0), min(k - BEGIN, 0) + max(k - end, 0), (k >= BEGIN, BEGIN <= k < end))
        for k in range(STEPS)
    ]
    log = [both(k, k - BEGIN, k - BEGIN, (False, False)) for k in range(STEPS)]
    return make_run(driven, log=log, **fields)


@pytest.mark.parametrize(
    ("place", "first"),
    [((12.0, -10.0), "either"), ((12.0, -1.0), "other"), ((2.5, -4.5), "ego"), ((2.5, -2.0), "neither")],
)
def test_who_could_go_first_has_a_free_way(place: tuple[float, float], first: str) -> None:
    (found,) = standoffs(made(place))
    wanted = {"agent": 2, "step": BEGIN, "end_step": END - 1, "could_go_first": first, "resolved": True}
    assert asdict(found) == wanted


def test_one_that_lasts_to_the_end_is_not_resolved() -> None:
    (found,) = standoffs(made((12.0, -10.0), end=STEPS))
    assert (found.end_step, found.resolved) == (STEPS - 1, False)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"place": (12.0, 0.0), "yaw": 0.2}, "a queue"),
        ({"place": (60.0, -10.0)}, "too far away"),
        ({"place": (12.0, -10.0), "end": BEGIN + 25}, "too short"),
        ({"place": (12.0, 10.0)}, "its way does not cross"),
    ],
)
def test_others_that_stand_are_no_standoff(change: dict[str, Any], why: str) -> None:
    assert standoffs(made(**change)) == [], why


@pytest.mark.parametrize(("state", "count"), [(SignalState.RED, 0), (SignalState.GREEN, 1)])
def test_a_light_that_holds_the_ego_is_the_reason(state: SignalState, count: int) -> None:
    stop, leave = np.array([5.0, 0.0]), np.array([25.0, 0.0])
    link = SignalLink("A -> B", "A", "B", stop, 0.0, 3.5, leave, 0.0)
    signals = Signals(("g",), (link,), np.array([0]), np.full((1, STEPS), state, np.uint8))
    assert len(standoffs(made((12.0, -10.0), signals=signals))) == count
