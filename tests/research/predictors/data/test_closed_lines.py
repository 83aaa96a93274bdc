"""Closed stop lines among recorded vehicles, for networks that see signals."""

import numpy as np
import pandas as pd
import pytest

from litsim_predictor.inference.closed_lines import ClosedLines
from litsim_research.predictors.data.scene import cut_scene
from litsim_research.predictors.data.sources import split
from litsim_research.predictors.data.tracks import Tracks
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import Signals, SignalsFile, signals_of

NET = packaged("nets/urban_like.net.xml")
BEGIN, FRAMES = 100, 120
GROUPS = {"west": ["WA"], "north": ["ANA"]}
CHANGES = [(10.0, "west", "red"), (14.0, "west", "green"), (10.0, "north", "green"), (14.0, "north", "amber")]


@pytest.fixture
def signals() -> Signals:
    return signals_of(SignalsFile(groups=GROUPS, changes=CHANGES), read_links(NET), FRAMES, BEGIN)


@pytest.fixture
def tracks(signals: Signals) -> Tracks:
    frame = np.arange(BEGIN, BEGIN + FRAMES)
    car = {"y": -4.95, "yaw": 0.0, "speed": 5.0, "length": 4.5, "width": 2.0}
    cars = [
        pd.DataFrame({"vehicle_id": k, "frame": frame, "x": -200.0 - 9 * k + 0.5 * (frame - BEGIN), **car})
        for k in (-3, 8)
    ]
    return Tracks.from_table("made", pd.concat(cars, ignore_index=True), NET, signals=signals, begin=BEGIN)


def test_lines_stand_among_the_vehicles_while_they_are_closed(tracks: Tracks, signals: Signals) -> None:
    lines = ClosedLines(signals)
    for step in (0, 39, 40, 100):
        rows = tracks.rows_at(BEGIN + step)
        there = rows[tracks.is_line[rows]]
        closed = lines.pose[lines.closed(step)[0]]
        assert len(there) == len(closed) == (3 if step < 40 else 2)
        assert {*map(tuple, tracks.motion[there, :3])} == {*map(tuple, closed)}
        assert not tracks.target[there].any() and tracks.target[rows].sum() == 2


def test_lines_have_a_past_as_runs_show_it_and_no_future(tracks: Tracks) -> None:
    rows = tracks.rows_at(BEGIN + 60)
    scene, line = cut_scene(tracks, rows), tracks.is_line[rows]
    assert scene.inputs.observed[line].sum(axis=1).tolist() == [11, 11]  # closed for 2 s
    assert not scene.future_known[line].any() and scene.future_known[~line].all()


def test_parts_have_lines_and_blind_models_none(tracks: Tracks) -> None:
    parts = split(tracks)
    assert all(tracks.is_line.sum() == part.is_line.sum() for (part,) in parts.values())
    assert sum(len(part.without_lines()) for (part,) in parts.values()) == 2 * FRAMES
    assert {*tracks.without_lines().vehicle.tolist()} == {-3, 8}
