"""The timing plan and the windows of examples/streets, and the fit of the plan's offset to vehicles."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from litsim_data.maps.map_format import CommonRoad
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import SignalsFile, signals_of
from programs import program

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "streets"
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


@pytest.fixture(scope="module")
def windows() -> ModuleType:
    sys.path.insert(0, str(FOLDER))  # of plan_offset
    return program("examples/streets/windows.py")


def test_windows_that_overlap_become_one(windows: ModuleType) -> None:
    rows = [
        ("USA_Lanker-a", 1, 0, 5.0),
        ("USA_Lanker-a", 1, 1, 6.0),
        ("USA_Lanker-b", 1, 0, 96.0),
        ("other", 2, 0, 0.0),
    ]
    rows += [("USA_Lanker-b", 1, 1, 97.0)]
    table = pd.DataFrame(rows, columns=["scenario", "vehicle_id", "frame", "x_m"]).assign(y_m=1.0)
    made = windows.joined(
        table, windows.Window({"Lanker-a": (0, 10.0, 0.0), "Lanker-b": (1, -80.0, 0.0)}, reported=True)
    )
    assert made[["frame", "x_m", "y_m"]].to_numpy().tolist() == [[0, 15.0, 1.0], [1, 16.0, 1.0], [2, 17.0, 1.0]]


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


def test_who_waits_and_who_passes_give_the_plan_away(windows: ModuleType) -> None:
    fit = windows.fit_offset(PLAN, LINKS, log_of(starting(9.0, 0.5), starting(9.5, 7.0)))  # green from about 7 s on
    low, high = fit.range_s
    assert low <= 7.0 <= high and high - low <= 4.0
    assert low <= fit.offset_s <= high
    assert (fit.passed, fit.at_red, fit.waits_s) == ({"east": 2}, {"east": 0}, 0.0)


def test_a_range_may_go_over_the_end_of_the_cycle(windows: ModuleType) -> None:
    fit = windows.fit_offset(PLAN, LINKS, log_of(starting(1.0, 8.0), np.full(STEPS, -60.0)))  # passes at 2.1 s
    low, high = fit.range_s
    assert low > high
    assert fit.offset_s == pytest.approx((low + (high + 30.0 - low) / 2) % 30.0, abs=0.5)


@pytest.mark.parametrize("red", [17.1, 17.3])
def test_the_ends_of_a_range_are_offsets_that_were_tried(windows: ModuleType, red: float) -> None:
    """Also of a cycle that is no multiple of the half second between them."""
    values = PLAN.model_dump()
    values["program"]["phases"][2]["duration_s"] = red
    fit = windows.fit_offset(
        SignalsFile.model_validate(values), LINKS, log_of(starting(1.0, 8.0), np.full(STEPS, -60.0))
    )
    low, high = fit.range_s
    assert low > high, "over the end of the cycle"
    assert all((each / 0.5).is_integer() for each in (low, high, fit.offset_s))


def test_vehicles_that_no_offset_explains_are_counted(windows: ModuleType) -> None:
    fit = windows.fit_offset(PLAN, LINKS, log_of(starting(0.5, 6.0), starting(14.5, 6.0)))
    assert sum(fit.at_red.values()) == 1


@pytest.mark.data
@pytest.mark.usefixtures("netconvert")
def test_the_plan_is_of_the_map(windows: ModuleType, real_data: Callable[..., Path], tmp_path: Path) -> None:
    CommonRoad().write_net(
        real_data(f"maps/commonroad/{windows.MAPS['lankershim']}_map.xml"), None, tmp_path / "l.net.xml"
    )
    plan = read_yaml(windows.PLAN, SignalsFile)
    signals = signals_of(plan, read_links(tmp_path / "l.net.xml"), 1001)
    assert signals.groups == ("east", "north", "south", "south_left", "west")
    assert len(signals.links) == 19  # all but the right turn from 3568_0
    assert (signals.states[:, 0] == signals.states[:, 1000]).all()  # the cycle is 100 s
