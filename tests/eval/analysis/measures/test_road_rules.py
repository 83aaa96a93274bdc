"""Driving direction, speed limits and stop signs, as the map has them."""

from collections.abc import Callable
from typing import Any

import pytest

from litsim_eval.analysis.measures.road_rules import rules
from litsim_sim.record.run import Run
from litsim_sim.scenario.scenario import packaged
from made_runs import make_run, table

NET = packaged("nets/urban_like.net.xml").read_bytes()
WITH_SIGN = NET.replace(
    b'fromLane="1" toLane="1" via=":A_11_1" tl="A" linkIndex="2" dir="s" state="O"',
    b'fromLane="1" toLane="1" via=":A_11_1" dir="s" state="s"',
)
LINE, WA_1, OPPOSITE = -114.6, -4.95, 4.95  # [m] x of the stop line, y of the lane to the east, and of one to the west


@pytest.fixture
def drive() -> Callable[..., Run]:
    """A run of an ego at these x [m], at y and speeds."""

    def make(x: list[float], y: float = WA_1, speed: list[float] | float = 10.0, net: bytes = NET, **more: int) -> Run:
        speeds = speed if isinstance(speed, list) else [speed] * len(x)
        driven = [
            table(k, {"id": 1, "x": at, "y": y, "speed": v}) for k, (at, v) in enumerate(zip(x, speeds, strict=True))
        ]
        return make_run(driven, net_xml=net, **more)

    return make


def test_metres_against_the_lanes_within_a_second(drive: Any) -> None:
    forwards = [LINE - 100.0 + k for k in range(31)]
    assert rules(drive(forwards))["wrong_way_m"] == 0.0
    assert rules(drive(forwards, OPPOSITE))["wrong_way_m"] == pytest.approx(10.0), "10 m/s for three seconds"
    slow = [LINE - 100.0 + 0.3 * k for k in range(31)]
    assert rules(drive(slow, OPPOSITE))["wrong_way_m"] == pytest.approx(3.0)


def test_speed_over_the_limit_and_nuplans_score(drive: Any) -> None:
    x = [LINE - 100.0 + k for k in range(11)]
    over = rules(drive(x, speed=[13.0, *[13.89 + 2.23] * 5, *[13.0] * 5]))
    assert over["over_limit_mps"] == pytest.approx(2.23)
    assert over["speed_score"] == pytest.approx(1.0 - 5 / 11), "nothing is left of 1 at 2.23 m/s all the time"
    inside = rules(drive([LINE + 5.0] * 3, speed=12.0))
    assert inside["over_limit_mps"] == 0.0, (
        "within a junction the limit of the roads holds, not SUMO's speed of turning"
    )
    assert over["log"]["over_limit_mps"] == over["over_limit_mps"]


def test_a_stop_sign_asks_for_a_stop_within_five_metres_of_its_line(drive: Any) -> None:
    assert WITH_SIGN != NET
    way = [LINE - 2.0 - 10.0 + 0.5 * k for k in range(60)]  # the front is 10 m before the line at first

    def signs(speed: list[float] | float, net: bytes = WITH_SIGN, **more: int) -> tuple[Any, Any]:
        found = rules(drive(way, speed=speed, net=net, **more))
        return found["stop_signs"], found["stop_signs_run"]

    stops_at = [0.0 if k == 16 else 5.0 for k in range(60)]  # 2 m before the line
    too_early = [0.0 if k == 5 else 5.0 for k in range(60)]  # 7.5 m
    assert (signs(5.0), signs(stops_at), signs(too_early)) == ((1, 1), (1, 0), (1, 1))
    assert signs(5.0, NET) == (None, None), "no net without signs passes or fails"
    assert signs(stops_at, history_steps=19) == (1, 0), "it has stopped in the history"
    assert signs(stops_at, history_steps=40) == (0, 0), "it passes in the history"
