"""The offset of a timing plan, found by vehicles that obey it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.plan_offset import TRIED_S, fit_offset
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import SignalsFile

LINKS = read_links(packaged("nets/urban_like.net.xml"))
LINE, STEPS = -114.6, 200
PLAN = SignalsFile.model_validate(
    {
        "groups": {"east": ["WA_1"]},
        "program": {
            "phases": [
                {"duration_s": 10, "states": {"east": "green"}},
                {"duration_s": 3, "states": {"east": "amber"}},
                {"duration_s": 17},
            ]
        },
    }
)


def log_of(*fronts: FloatArray) -> Log:
    """Cars on lane WA_1, whose fronts are so far beyond its stop line at each step [m]."""
    cars = []
    for number, front in enumerate(fronts, 1):
        x = LINE + front - 2.0
        speed = np.abs(np.gradient(front, 0.1))
        cars.append(pd.DataFrame({"vehicle_id": number, "frame": np.arange(STEPS), "x": x, "y": -4.95, "speed": speed}))
    same = {"yaw": 0.0, "acceleration": 0.0, "length": 4.0, "width": 1.8, "kind": 0, "lane": -1}
    table = pd.concat(cars).assign(**same)
    return Log.from_recording(Recording.from_table(RecordingHeader("made"), table, "made"), 0, STEPS)


def starting(at: float, behind: float) -> FloatArray:
    """Stands so far before the line until a time, then drives 8 m/s."""
    return -behind + 8.0 * np.clip(np.arange(STEPS) * 0.1 - at, 0.0, 5.0)


def test_who_waits_and_who_passes_give_the_plan_away() -> None:
    fit = fit_offset(PLAN, LINKS, log_of(starting(9.0, 0.5), starting(9.5, 7.0)))  # green from about 7 s on
    low, high = fit.range_s
    assert low <= 7.0 <= high and high - low <= 4.0
    assert low <= fit.offset_s <= high
    assert (fit.passed, fit.at_red, fit.waits_s) == ({"east": 2}, {"east": 0}, 0.0)


def test_a_range_may_go_over_the_end_of_the_cycle() -> None:
    fit = fit_offset(PLAN, LINKS, log_of(starting(1.0, 8.0), np.full(STEPS, -60.0)))  # passes at 2.1 s
    low, high = fit.range_s
    assert low > high
    assert fit.offset_s == pytest.approx((low + (high + 30.0 - low) / 2) % 30.0, abs=0.5)


@pytest.mark.parametrize("red", [17.1, 17.3])
def test_the_ends_of_a_range_are_offsets_that_were_tried(red: float) -> None:
    """Also of a cycle that is no multiple of the half second between them."""
    values = PLAN.model_dump()
    values["program"]["phases"][2]["duration_s"] = red
    fit = fit_offset(SignalsFile.model_validate(values), LINKS, log_of(starting(1.0, 8.0), np.full(STEPS, -60.0)))
    low, high = fit.range_s
    assert low > high, "over the end of the cycle"
    assert all((each / TRIED_S).is_integer() for each in (low, high, fit.offset_s))


def test_vehicles_that_no_offset_explains_are_counted() -> None:
    fit = fit_offset(PLAN, LINKS, log_of(starting(0.5, 6.0), starting(14.5, 6.0)))
    assert sum(fit.at_red.values()) == 1
