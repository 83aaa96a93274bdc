"""What SimNet is shown: the road, the stop lines, itself and the others, by frame, from where it stands."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from litsim_predictor.inference.raster import raster_of_net
from litsim_research.baselines.simnet.raster import (
    CHANNELS,
    CLOSENESS,
    COSINE,
    FRAMES,
    OTHERS,
    OWN,
    SINE,
    SMALL,
    STOP,
    Motions,
    Painter,
)
from litsim_sim.core.signals import SignalState
from litsim_sim.scenario.scenario import Scenario

LANES, NET = raster_of_net(Scenario.load("demo").net_path)
LANE = -1.5 * 3.66  # middle of the second lane from the left, which leads along +x
NOW = FRAMES - 1


def driving(*agents: tuple[float, float, float, float], scene: tuple[int, ...] = ()) -> Motions:
    """Agents with x, y, yaw at present, who have driven straight on at a speed."""
    x, y, yaw, speed = np.array(agents, np.float64).T[:, :, None]
    gone = speed * 0.1 * np.arange(1 - FRAMES, 1)
    pose = np.stack([x + gone * np.cos(yaw), y + gone * np.sin(yaw), np.broadcast_to(yaw, gone.shape)], axis=-1)
    there = np.ones(gone.shape, np.bool_)
    return Motions(pose, there, np.tile([4.0, 2.0], (len(agents), 1)), np.array(scene or (0,) * len(agents)))


def drawn(motions: Motions, *rows: int, **more: Any) -> np.ndarray:
    return Painter(NET.drawn, None).draw(0, motions, np.array(rows, np.int64), **more).copy()


def centre(plane: np.ndarray) -> tuple[float, float]:
    """Metres ahead of the agent and to its left of the middle of what is drawn."""
    rows, columns = np.indices(plane.shape) + 0.5
    ahead, left = (np.average(grid, weights=plane) * SMALL.cell for grid in (rows, columns))
    return ahead - 0.25 * SMALL.rows * SMALL.cell, left - 0.5 * SMALL.columns * SMALL.cell


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_boxes_lie_where_they_are_to_parts_of_a_cell(yaw: float) -> None:
    """The agent was behind itself; the other one is 20.3 m ahead and 3.1 m to the left, and drives 5 m/s slower."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    other = (200.0 + 20.3 * cos - 3.1 * sin, LANE + 20.3 * sin + 3.1 * cos, yaw, 5.0)
    (raster,) = drawn(driving((200.0, LANE, yaw, 10.0), other), 0)
    assert raster.shape == (CHANNELS, SMALL.rows, SMALL.columns)
    for frame in range(FRAMES):
        ago = 0.1 * (NOW - frame)
        assert centre(raster[OWN + frame]) == pytest.approx((-10.0 * ago, 0.0), abs=0.02)
        assert centre(raster[OTHERS + frame]) == pytest.approx((20.3 - 5.0 * ago, 3.1), abs=0.02)
    area = raster[OTHERS + NOW].sum() * SMALL.cell**2
    assert area == pytest.approx(8.0, rel=0.02)


def test_the_road_is_that_of_the_net() -> None:
    yaw = 0.3
    (raster,) = drawn(driving((200.0, LANE, yaw, 10.0)), 0)
    ahead, left = np.meshgrid(np.arange(96) + 0.5 - 24.0, np.arange(48) + 0.5 - 24.0, indexing="ij")
    x, y = 200.0 + ahead * np.cos(yaw) - left * np.sin(yaw), LANE + ahead * np.sin(yaw) + left * np.cos(yaw)
    road = LANES.inside_road(x.ravel(), y.ravel()).reshape(ahead.shape)
    assert ((raster[CLOSENESS] > 0) == road).mean() > 0.97 and 0.1 < road.mean() < 0.9
    at = LANES.nearest(x[road], y[road])
    half = 0.5 * np.array([LANES.lanes[lane].width for lane in at.lane])
    expected = np.maximum(1.0 - np.abs(at.d) / half, 0.0)
    assert np.median(np.abs(raster[CLOSENESS][road] - expected)) < 0.05
    along = raster[COSINE][road] != 0
    assert along.mean() > 0.95
    assert raster[COSINE][road][along] == pytest.approx(np.cos(at.heading - yaw)[along], abs=0.05)
    assert raster[SINE][road][along] == pytest.approx(np.sin(at.heading - yaw)[along], abs=0.05)


def test_nothing_is_shown_of_who_was_not_there_and_of_other_scenes() -> None:
    motions = driving((200.0, LANE, 0.0, 10.0), (220.0, LANE, 0.0, 10.0), (230.0, LANE, 0.0, 10.0), scene=(0, 0, 1))
    motions.there[1, :3] = False
    (raster,) = drawn(motions, 0)
    assert not raster[OTHERS : OTHERS + 3].any()
    assert centre(raster[OTHERS + NOW]) == pytest.approx((20.0, 0.0), abs=0.02)


def test_a_raster_does_not_depend_on_what_was_drawn_before_or_is_drawn_beside() -> None:
    motions = driving(*((150.0 + 12.0 * k, LANE + (k % 3) * 3.0, 0.1 * k, 8.0) for k in range(9)))
    painter = Painter(NET.drawn, None)
    every = painter.draw(0, motions, np.arange(9)).copy()
    for row in (8, 3):
        assert np.array_equal(painter.draw(0, motions, np.array([row]))[0], every[row])


def test_an_agent_can_be_drawn_where_it_is_not() -> None:
    motions = driving((200.0, LANE, 0.0, 10.0), (220.0, LANE, 0.0, 10.0))
    (there,) = drawn(driving((200.0, LANE + 1.0, 0.0, 10.0), (220.0, LANE, 0.0, 10.0)), 0)
    moved = motions.pose[:1] + np.array([0.0, 1.0, 0.0])
    assert np.array_equal(drawn(motions, 0, own=moved)[0], there)


def test_stop_lines_are_shown_while_they_are_closed() -> None:
    link = SimpleNamespace(stop=np.array([230.0, LANE]), heading=0.0, width=3.0)
    shows = [SignalState.RED, SignalState.GREEN, SignalState.AMBER]
    signals: Any = SimpleNamespace(links=(link,), of_links=lambda step: np.array([[shows[step]]], np.uint8))
    painter = Painter(NET.drawn, signals)
    seen = [painter.draw(step, driving((200.0, LANE, 0.0, 10.0)), np.array([0]))[0, STOP].copy() for step in range(3)]
    assert not seen[1].any()
    for closed in (seen[0], seen[2]):
        assert centre(closed) == pytest.approx((30.0, 0.0), abs=0.02)
        assert closed.sum() == pytest.approx(3.0, rel=0.02)


def test_each_scene_has_its_own_closed_stop_lines() -> None:
    link = SimpleNamespace(stop=np.array([230.0, LANE]), heading=0.0, width=3.0)
    shows = np.array([[SignalState.RED], [SignalState.GREEN], [SignalState.RED]], np.uint8)
    signals: Any = SimpleNamespace(links=(link,), of_links=lambda _: shows)
    motions = driving(*[(200.0, LANE, 0.0, 10.0)] * 3, scene=(0, 1, 2))
    seen = Painter(NET.drawn, signals).draw(0, motions, np.arange(3))[:, STOP]
    assert not seen[1].any()
    assert seen[0].any() and np.array_equal(seen[0], seen[2]), "a line is drawn once, however many scenes have it"
