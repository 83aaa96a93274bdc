"""The timing plan and the windows of examples/lankershim."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

from litsim_data.maps.map_format import CommonRoad
from litsim_data.maps.netconvert import find_netconvert
from litsim_sim.core.errors import InputError
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.signals import SignalsFile, shown

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "lankershim"


@pytest.fixture(scope="module")
def windows() -> ModuleType:
    spec = importlib.util.spec_from_file_location("lankershim_windows", FOLDER / "windows.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look there
    spec.loader.exec_module(module)
    return module


def test_windows_that_overlap_become_one(windows: ModuleType) -> None:
    rows = [
        ("USA_Lanker-a", 1, 0, 5.0),
        ("USA_Lanker-a", 1, 1, 6.0),
        ("USA_Lanker-b", 1, 0, 96.0),
        ("other", 2, 0, 0.0),
    ]
    rows += [("USA_Lanker-b", 1, 1, 97.0)]
    table = pd.DataFrame(rows, columns=["scenario", "vehicle_id", "frame", "x_m"]).assign(y_m=1.0)
    made = windows.joined(table, windows.Window({"a": (0, 10.0, 0.0), "b": (1, -80.0, 0.0)}, reported=True))
    assert made[["frame", "x_m", "y_m"]].to_numpy().tolist() == [[0, 15.0, 1.0], [1, 16.0, 1.0], [2, 17.0, 1.0]]


@pytest.mark.data
def test_the_plan_is_of_the_map(windows: ModuleType, real_data: Callable[..., Path], tmp_path: Path) -> None:
    try:
        find_netconvert()
    except InputError as error:
        pytest.skip(str(error))
    CommonRoad().write_net(real_data(windows.MAP), None, tmp_path / "l.net.xml")
    plan = read_yaml(FOLDER / "plan.yaml", SignalsFile)
    signals = shown(plan, read_links(tmp_path / "l.net.xml"), 1001)
    assert signals.groups == ("east", "north", "south", "south_left", "west")
    assert len(signals.links) == 19  # all but the right turn from 3568_0
    assert (signals.states[:, 0] == signals.states[:, 1000]).all()  # the cycle is 100 s
