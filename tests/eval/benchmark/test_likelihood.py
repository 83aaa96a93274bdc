"""Planted drivers under published measures: the recording wins, on the demo."""

import pytest

from litsim_sim.scenario.scenario import Scenario
from programs import program

likelihood = program("benchmarks/likelihood/rows.py")


@pytest.fixture(scope="module")
def rows() -> dict[str, dict[str, float]]:
    measured: dict[str, dict[str, float]] = likelihood.rows(Scenario.load("demo"))
    return measured


@pytest.mark.parametrize(
    "measure", ["`sim_agents.score`", "`.kinematic`", "`.interaction`", "`.map`", "`realism.score`"]
)
def test_the_recording_is_likelier_than_constant_velocity_and_that_than_random(
    rows: dict[str, dict[str, float]], measure: str
) -> None:
    recording, constant, random = (rows[name][measure] for name in ("recording", "constant velocity", "random"))
    assert recording > constant > random


def test_the_recording_does_nothing_that_counts_against_it(rows: dict[str, dict[str, float]]) -> None:
    against = list(rows["recording"])[-7:]
    assert [rows["recording"][name] for name in against] == [0] * 7
    for name in ("constant velocity", "random"):
        assert rows[name]["`.contact_share`"] > 0.0 < rows[name]["`.off_road`"]
