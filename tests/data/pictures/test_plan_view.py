"""What the picture of an intersection shows, and which runs have one."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from litsim_data.pictures.plan_view import LIGHTS, Area, crossed, draw_signals, groups_in, paths
from litsim_eval.pictures import overview as plots
from litsim_sim.core.scene import Controller
from litsim_sim.core.signals import SignalState
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import SignalLink
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import Signals

STREET, MOTORWAY = (packaged(f"nets/{name}.net.xml") for name in ("urban_like", "us101_like"))


def link(name: str, x: float) -> SignalLink:
    stop = np.array([x, 0.0])
    return SignalLink(name, f"{name}_0", f"{name}_1", stop, 0.0, 3.0, np.array([x + 20.0, 0.0]), 0.0)


@pytest.fixture
def signals() -> Signals:
    """Groups a, b and far; b turns green at step 20."""
    states = np.full((3, 41), SignalState.RED, np.uint8)
    states[1, 20:] = SignalState.GREEN
    links = link("a", 0.0), link("b", 10.0), link("far", 500.0)
    return Signals(("a", "b", "far"), links, np.array([0, 1, 2]), states)


def test_a_way_over_a_junction_crosses_lanes_and_one_on_a_road_does_not() -> None:
    street, along = LaneMap.from_net(STREET), np.array([[-150.0, -5.0], [-60.0, -5.0]])
    assert len(crossed(street, along))
    assert not len(crossed(street, along + np.array([90.0, 0.0]))), "between both junctions"
    assert not len(crossed(street, np.empty((0, 2))))
    assert not len(crossed(LaneMap.from_net(MOTORWAY), np.array([[0.0, -5.0], [600.0, -5.0]])))
    assert not len(crossed(None, along))


def test_signals_in_view_come_with_the_ego_s_first(signals: Signals) -> None:
    area = Area.around(np.array([[0.0, 0.0], [20.0, 0.0]]))
    assert groups_in(signals, area, []) == [0, 1]
    assert groups_in(signals, area, ["b", "b"]) == [1, 0]


def test_bars_show_each_state_for_as_long_as_it_lasts(signals: Signals) -> None:
    axes = Figure().add_subplot()
    draw_signals(axes, signals, [0, 1], 40)
    first, second = axes.collections
    spans = [path.get_extents() for path in second.get_paths()]
    assert [(box.x0, box.x1) for box in spans] == [pytest.approx((0.0, 2.0)), pytest.approx((2.0, 4.1))]
    shown = [to_hex(colour) for colour in second.get_facecolors()]
    assert shown == [LIGHTS[SignalState.RED], LIGHTS[SignalState.GREEN]]
    assert len(first.get_paths()) == 1
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a", "b"]


def test_paths_are_told_by_who_moves_the_agent(table: Any) -> None:
    moved = [Controller.LOG, Controller.POLICY, Controller.LOG]
    tables = [table(k, {"id": 2, "x": 5.0 * k, "y": 0.0, "controller": c}) for k, c in enumerate(moved)]
    found = paths(Steps.of(tables), Area.around(np.zeros((1, 2))))
    assert [piece.tolist() for piece in found[Controller.POLICY]] == [[[0.0, 0.0], [5.0, 0.0]]]
    assert [piece.tolist() for piece in found[Controller.LOG]] == [[[5.0, 0.0], [10.0, 0.0]]]
    assert not found[Controller.EGO]


def test_a_path_is_a_line_until_the_agent_leaves_the_picture_or_is_gone_for_a_step(table: Any) -> None:
    places = [0.0, 5.0, 10.0, None, 15.0, 500.0, 900.0, 20.0]
    tables = [table(k, *([] if x is None else [{"id": 2, "x": x, "y": 0.0}])) for k, x in enumerate(places)]
    lines = paths(Steps.of(tables), Area.around(np.zeros((1, 2))))[Controller.LOG]
    assert [line[:, 0].tolist() for line in lines] == [[0.0, 5.0, 10.0], [15.0, 500.0], [900.0, 20.0]]


@pytest.mark.parametrize(("net", "y", "seen"), [(STREET, -5.0, "_plan"), (MOTORWAY, -5.5, "_space_time")])
def test_the_overview_is_chosen_by_the_road(
    make_run: Any, table: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, net: Path, y: float, seen: str
) -> None:
    drawn = []
    for name in ("_plan", "_space_time"):
        real = getattr(plots, name)
        monkeypatch.setattr(plots, name, lambda *a, name=name, real=real: (drawn.append(name), real(*a)))
    start = -140.0 if net == STREET else 100.0
    tables = [table(k, {"id": 1, "x": start + k, "y": y}, {"id": 2, "x": start + k - 9, "y": y}) for k in range(80)]
    plots.overview(make_run(tables, net_xml=net.read_bytes()), tmp_path / "overview.png")
    assert drawn == [seen]
    assert (tmp_path / "overview.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("net", "y"), [(STREET, -5.0), (MOTORWAY, -5.5)])
def test_no_legend_covers_the_name_of_an_axis(
    make_run: Any, table: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, net: Path, y: float
) -> None:
    """A long way along a street makes a low picture; the legend is below it, not a share of its height further down."""
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    tables = [table(k, {"id": 1, "x": 2.5 * k - 50.0, "y": y}, {"id": 2, "x": 200.0, "y": y}) for k in range(80)]
    plots.overview(make_run(tables, net_xml=net.read_bytes()), tmp_path / "overview.png")
    (figure,) = drawn
    figure.canvas.draw()
    low = [(axes, found) for axes in figure.axes if (found := axes.get_legend())]
    low = [(axes, legend) for axes, legend in low if legend.get_window_extent().y1 < axes.get_window_extent().y0]
    ((axes, legend),) = low
    assert legend.get_window_extent().y1 < axes.xaxis.label.get_window_extent().y0


@pytest.mark.filterwarnings("error::UserWarning")
def test_a_run_that_failed_at_its_first_step_has_an_overview_without_warnings(
    make_run: Any, table: Any, tmp_path: Path
) -> None:
    plots.overview(make_run([table(0, {"id": 1, "x": 200.0, "y": -5.5})]), tmp_path / "overview.png")
    assert (tmp_path / "overview.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.filterwarnings("error::UserWarning")
def test_an_agent_off_its_log_far_beside_the_road_does_not_shrink_the_overview(
    make_run: Any, table: Any, tmp_path: Path
) -> None:
    far = {"id": 2, "x": 210.0, "y": 500.0, "controller": Controller.POLICY}
    plots.overview(make_run([table(0, {"id": 1, "x": 200.0, "y": -5.5}, far)]), tmp_path / "overview.png")
    assert (tmp_path / "overview.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("passed", "shown"), [((), ["a"]), (("b", "a"), ["b", "a"])])
def test_an_overview_shows_all_signals_that_the_ego_passes_and_says_how_many_it_leaves_out(
    make_run: Any,
    table: Any,
    signals: Signals,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    passed: tuple[str, ...],
    shown: list[str],
) -> None:
    monkeypatch.setattr(plots, "GROUPS_MAX", 1)
    tables = [table(k, {"id": 1, "x": 2.0 * k - 140.0, "y": -5.0}) for k in range(80)]
    run = replace(make_run(tables, net_xml=STREET.read_bytes()), signals=signals)
    passages = [SimpleNamespace(agent=run.info.ego_id, group=name, step=20) for name in passed]
    monkeypatch.setattr(plots, "run_passages", lambda _: passages)
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    plots.overview(run, tmp_path / "overview.png")
    (axes,) = [each for part in drawn[0].subfigs for each in part.axes if "ignals" in each.get_title(loc="left")]
    assert [label.get_text() for label in axes.get_yticklabels()] == shown
    assert axes.get_title(loc="left").startswith("Signals" if passed else "1 of 2 signals")
