"""Pedestrians and cyclists of a table, kept as obstacles."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import made_tables
from litsim_data.generic.obstacles import USUAL_SIZES
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind

Traffic = Callable[..., pd.DataFrame]
KINDS = {"car": "car", "walker": "pedestrian", "rider": "bicycle"}
COLUMNS = {
    "vehicle_id": "track_id",
    "time": "timestamp",
    "x": "x",
    "y": "y",
    "yaw": "heading",
    "speed": "speed",
    "length": "length",
    "width": "width",
    "kind": "agent_type",
}


def people(**columns: object) -> pd.DataFrame:
    """A pedestrian (id 11) who walks along +y, and one on a bicycle (id 12), as data sets have them."""
    t = np.arange(0.0, 10.0, 0.04)
    walker = {"track_id": 11, "x": 60.0, "y": 1.3 * t, "agent_type": "walker", "length": 0.0, "width": 0.0}
    rider = {"track_id": 12, "x": 60.0 - 4.0 * t, "y": 5.0, "agent_type": "rider", "length": 1.6, "width": 0.7}
    both = [pd.DataFrame({"timestamp": t, "heading": np.nan, "speed": np.nan, **each}) for each in (walker, rider)]
    return pd.concat(both, ignore_index=True).assign(**columns)


def converted(table: pd.DataFrame, folder: Path, **fields: object) -> tuple[pd.DataFrame, dict[str, object], str]:
    usual = {"name": "case", "columns": COLUMNS, "reference": "box_centre", "kinds": KINDS}
    recording, counts = made_tables.converted(folder / "case.csv", table, usual | fields)
    return recording.table, recording.header.notes, counts.text()


def test_their_headings_and_speeds_are_those_of_their_motion(tmp_path: Path, traffic: Traffic) -> None:
    table, notes, said = converted(pd.concat([traffic(), people()]), tmp_path)
    walker, rider = (table[table["vehicle_id"] == agent] for agent in (11, 12))
    assert set(walker["kind"]) == {Kind.PEDESTRIAN} and set(rider["kind"]) == {Kind.BICYCLE}
    np.testing.assert_allclose(walker["yaw"], 0.5 * np.pi, atol=1e-6)
    np.testing.assert_allclose(np.abs(rider["yaw"]), np.pi, atol=1e-6)
    np.testing.assert_allclose(walker["speed"], 1.3, atol=1e-6)
    np.testing.assert_allclose(rider["speed"], 4.0, atol=1e-6)
    np.testing.assert_allclose(rider["acceleration"], 0.0, atol=1e-6)
    assert walker[["length", "width"]].iloc[0].tolist() == list(USUAL_SIZES[Kind.PEDESTRIAN])
    assert rider[["length", "width"]].iloc[0].tolist() == [1.6, 0.7]
    assert notes["tracks_of_usual_size"] == 1 and "1 agents without a usable size got a usual one" in said


def test_vehicles_are_as_without_them(tmp_path: Path, traffic: Traffic) -> None:
    for clean in (False, True):
        alone = converted(traffic(), tmp_path, clean=clean)[0]
        table = converted(pd.concat([traffic(), people()]), tmp_path, clean=clean)[0]
        vehicles = table[table["kind"] == Kind.CAR].reset_index(drop=True)
        pd.testing.assert_frame_equal(vehicles, alone, check_exact=True)
        assert set(table["vehicle_id"]) - set(alone["vehicle_id"]) == {11, 12}


def test_one_size_for_every_vehicle_is_not_theirs(tmp_path: Path, traffic: Traffic) -> None:
    columns = COLUMNS | {"length": 4.6, "width": 1.9}
    table = converted(pd.concat([traffic(), people()]), tmp_path, columns=columns)[0]
    sizes = table.groupby("kind")[["length", "width"]].first()
    assert sizes.loc[int(Kind.CAR)].tolist() == [4.6, 1.9]
    for kind in (Kind.BICYCLE, Kind.PEDESTRIAN):
        assert sizes.loc[int(kind)].tolist() == list(USUAL_SIZES[kind])


def test_they_say_nothing_of_the_units_of_vehicles(tmp_path: Path, traffic: Traffic) -> None:
    many = pd.concat([people().assign(track_id=lambda rows, n=n: rows["track_id"] + 10 * n) for n in range(10)])
    assert len(converted(pd.concat([traffic(), many]), tmp_path)[0]), "most agents are small and slow"
    with pytest.raises(InputError, match=r"units\.size ft would fit"):
        converted(pd.concat([traffic(length=1 / 0.3048, width=1 / 0.3048), many]), tmp_path)


def test_who_jumps_is_named(tmp_path: Path, traffic: Traffic) -> None:
    walking = people()
    walking.loc[(walking["track_id"] == 11) & (walking["timestamp"] >= 4.0), "x"] += 3.0
    named = walking.assign(track_id="P" + walking["track_id"].astype(str))
    for table, who in ((walking, "11"), (named, "P11")):
        with pytest.raises(InputError, match=rf"pedestrian {who} jumps 3\.\d s after frame 0.* rows: leave it out by"):
            converted(pd.concat([traffic(), table]), tmp_path)


def test_nobody_else(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="only pedestrians and cyclists are left"):
        converted(people(), tmp_path)
