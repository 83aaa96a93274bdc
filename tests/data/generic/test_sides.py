"""An axis that points down is told by the sides on which vehicles drive, with the figures."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import made_tables
from litsim_data.generic.checks import sides
from litsim_sim.core.errors import InputError

COLUMNS = {"vehicle_id": "id", "time": "t", "x": "x", "y": "y", "yaw": "yaw", "length": 4.5, "width": 1.8}
TURN = 0.7  # [rad] of the whole road


def road(lanes_right: int, lanes_back: int, mirrored: bool = False, strip: float = 0.0) -> pd.DataFrame:
    """Traffic that keeps to the right on a road that turns by TURN, at 25 Hz; lane 1 is the left one of each way.

    The two ways are `strip` metres apart.
    """
    cars, t = [], np.arange(0.0, 10.0, 0.04)
    for back, lanes in ((False, lanes_right), (True, lanes_back)):
        for lane in range(1, lanes + 1):
            for number in range(4):
                along, right = 9.0 * t + 25.0 * number + 3.0 * lane, 1.75 + 3.5 * (lane - 1) + 0.5 * strip
                u, v, yaw = (100.0 - along, right, np.pi) if back else (along, -right, 0.0)
                x, y = np.cos(TURN) * u - np.sin(TURN) * v, np.sin(TURN) * u + np.cos(TURN) * v
                name = 100 * back + 10 * lane + number
                cars.append(pd.DataFrame({"id": name, "t": t, "x": x, "y": y, "yaw": yaw + TURN, "lane": lane}))
    table = pd.concat(cars, ignore_index=True)
    return table.assign(y=-table["y"], yaw=-table["yaw"]) if mirrored else table


def converted(folder: Path, table: pd.DataFrame, lanes: bool = False, **fields: Any) -> pd.DataFrame:
    columns = COLUMNS | ({"lane": "lane"} if lanes else {})
    mapping = {"name": "made", "columns": columns, "reference": "box_centre"} | fields
    return made_tables.converted(folder / "in.parquet", table, mapping)[0].table


@pytest.mark.parametrize("lanes", [False, True])
def test_traffic_on_the_right_is_taken(tmp_path: Path, lanes: bool) -> None:
    assert converted(tmp_path, road(2, 2), lanes)["vehicle_id"].nunique() == 16
    mended = converted(tmp_path, road(2, 2, mirrored=True), lanes, transform={"mirror_y": True})
    pd.testing.assert_frame_equal(mended, converted(tmp_path, road(2, 2), lanes), atol=1e-6, rtol=0.0)


def test_oncoming_traffic_on_the_right(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        converted(tmp_path, road(1, 1, mirrored=True))
    said = str(caught.value)
    assert "oncoming vehicles pass on the right, 3.5 m beside, in 100% of 1" in said
    assert "transform.mirror_y corrects" in said and "(check side)" in said and "nothing was written" in said
    accepted = converted(tmp_path, road(1, 1, mirrored=True), accept=["side"])
    assert accepted["vehicle_id"].nunique() == 8, "they may keep to the left there"


def test_carriageways_apart(tmp_path: Path) -> None:
    assert converted(tmp_path, road(2, 2, strip=10.0))["vehicle_id"].nunique() == 16
    with pytest.raises(InputError, match=r"pass on the right, 17\.0 m beside, in 100% of"):
        converted(tmp_path, road(2, 2, mirrored=True, strip=10.0))
    narrow = road(1, 1).assign(id=lambda table: table["id"] + 1000, y=lambda table: table["y"] - 300.0)
    both = pd.concat([narrow, road(3, 3, mirrored=True, strip=10.0)])
    assert converted(tmp_path, both)["vehicle_id"].nunique() == 32, "those that pass close by each other decide"


def test_many_vehicles_at_a_time_take_little_time() -> None:
    number, instants = np.arange(5000), np.arange(0.0, 2.0, 0.1)
    table = pd.DataFrame({"vehicle_id": np.repeat(number, len(instants)), "t": np.tile(instants, len(number))})
    table["x"], table["y"], table["lane"] = 12.0 * table["t"] + 50.0 * (table["vehicle_id"] % 100), 0.0, -1
    table["y"] = 50.0 * (table["vehicle_id"] // 100)
    begin = time.process_time()
    assert not len(sides(table)[0])
    assert time.process_time() - begin < 5.0, "all pairs of them take longer"


def test_lanes_that_grow_to_the_left(tmp_path: Path) -> None:
    assert converted(tmp_path, road(3, 0, mirrored=True))["vehicle_id"].nunique() == 12, "nothing tells"
    with pytest.raises(InputError, match=r"next higher number is 3\.5 m to the left for 100% of \d+ pairs"):
        converted(tmp_path, road(3, 0, mirrored=True), lanes=True)


def test_lanes_that_are_counted_across_both_directions(tmp_path: Path) -> None:
    table = road(2, 2)
    back = table["id"] >= 100  # numbers grow downwards in the picture, as highD's
    table["lane"] = np.where(back, 3 - table["lane"], table["lane"])
    assert converted(tmp_path, table)["vehicle_id"].nunique() == 16
    with pytest.raises(InputError, match=r"higher number is 3\.5 m to the left for 50% of .*columns\.lane has to go"):
        converted(tmp_path, table, lanes=True)


def test_who_turns_or_stands_is_nobodys_opposite() -> None:
    table = road(1, 1).rename(columns={"id": "vehicle_id"}).sort_values(["vehicle_id", "t"], ignore_index=True)
    oncoming, next_lane = sides(table)
    assert len(oncoming) >= 10 and oncoming == pytest.approx(3.5) and not len(next_lane)
    standing = table["vehicle_id"] >= 100
    parked = table.assign(x=table["x"].where(~standing, 20.0), y=table["y"].where(~standing, 10.0))
    assert not len(sides(parked)[0])
    later = table.assign(t=table["t"] + np.where(standing, 60.0, 0.0))
    assert not len(sides(later)[0]), "when the others come, they have gone"
