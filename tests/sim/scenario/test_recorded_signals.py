"""Signals of a whole recording against its vehicles."""

from collections.abc import Callable
from typing import Any

import pandas as pd
import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.recorded_signals import survey
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import SignalsFile

NET = packaged("nets/urban_like.net.xml")


@pytest.fixture
def recording(track: Any) -> Callable[..., Recording]:
    """Cars at 10 m/s from x, y on, one from each of `starts`; on WA_1, at the line a second later, if not told."""

    def made(starts: list[int], x: float = -126.6, y: float = -4.95, frames: int = 30) -> Recording:
        cars = (track(n, x, y, first=k, last=k + frames - 1, length=4.0, width=1.8) for n, k in enumerate(starts, 1))
        return Recording.from_table(RecordingHeader("made"), pd.concat(car.rows() for car in cars), "made")

    return made


def signals(**fields: Any) -> SignalsFile:
    return SignalsFile.model_validate({"groups": {"east": ["WA"], "north": ["ANA"]}} | fields)


def test_pieces_are_counted_together(recording) -> None:
    given = signals(changes=[[0.0, "east", "green"], [65.0, "east", "red"]])
    lines = survey(given, NET, recording([0, 20, 610, 630, 670]), "made")
    assert lines == ["signals    east: 5 vehicles pass, 1 at red", "signals    north: 0 vehicles pass, 0 at red"]


@pytest.mark.parametrize("passes", [30, 590, 598, 599, 600, 601])
def test_who_passes_as_a_piece_ends_is_of_the_group_of_its_way(recording, passes: int) -> None:
    """Straight on, from a lane from which a right turn, whose way out is nearer, has another signal."""
    line = next(link for link in read_links(NET) if link.name == "WA_0 -> AB_0")
    made = recording([0], line.stop[0] - 2.0 - passes, line.stop[1], 660)
    given = {"groups": {"on": ["WA_0 -> AB_0"], "right": ["WA_0 -> AAS_0"]}, "changes": [[0.0, "on", "green"]]}
    lines = survey(SignalsFile.model_validate(given), NET, made, "made")
    assert lines == ["signals    on: 1 vehicles pass, 0 at red", "signals    right: 0 vehicles pass, 0 at red"]


def test_signals_are_judged_by_the_whole_recording(recording) -> None:
    """All who pass in the second minute do so at red, but most pass in the first."""
    given = signals(changes=[[0.0, "east", "green"], [60.0, "east", "red"]])
    lines = survey(given, NET, recording([*range(0, 120, 20), *range(610, 710, 20)]), "made")
    asked = "so many hardly do, but for right turns: are its connections and times right?"
    assert lines[0] == f"signals    east: 11 vehicles pass, 5 at red; {asked}"


def test_signals_that_nobody_heeds_are_refused(recording) -> None:
    given = signals(changes=[[0.0, "east", "red"]])
    with pytest.raises(
        InputError, match=r"^made: field signals: group east: 5 of 5 vehicles pass its stop lines at red"
    ):
        survey(given, NET, recording([0, 20, 40, 60, 80]), "made")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ([], "there are no changes"),
        ([[36000.0, "east", "red"]], "the first change is at 36000 s: are unit and clock right"),
    ],
)
def test_signals_of_another_time_are_refused(recording, changes: list[Any], said: str) -> None:
    with pytest.raises(InputError, match=rf"^made: .*no group shows anything from 0 to 10\.9 s.*{said}"):
        survey(signals(changes=changes), NET, recording([0, 20, 40, 60, 80]), "made")
