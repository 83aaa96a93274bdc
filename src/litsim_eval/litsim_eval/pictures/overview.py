"""The overview picture of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from litsim_data.pictures.plan_view import (
    Area,
    crossed,
    draw_boxes,
    draw_lanes,
    draw_signals,
    draw_stop_lines,
    frame,
    groups_in,
    line_handle,
    paths,
    pieces,
    tracks,
)
from litsim_eval.analysis.measures.collision import collisions
from litsim_eval.analysis.measures.signals import run_passages
from litsim_eval.analysis.measures.takeover import LedgerEntry, ledger
from litsim_eval.pictures.bird_view import AHEAD, BEHIND, COLOURS, NAMES, View, boxes_of, draw_traffic, legend_handles
from litsim_sim.core.colours import FAINT, INK
from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import AgentTable, Controller, FloatArray
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

SIZE_PX, DPI = (1600, 1120), 100
SAME_LANE, BESIDE = 1.8, 5.5  # [m] lateral distance up to which an agent is in the ego's lane, or in an adjacent one
LEGEND_BELOW_PT = 36.0  # [pt] from the x axis to a legend below it: its tick labels and its name come between
LATER = 5  # steps after a contact at which it is shown
GROUPS_MAX = 12  # signal groups that are shown, unless the ego passes more
DRAWN_MAX = 3000  # most steps of a space-time diagram, which has fewer pixels
ROUTE_MAX = 3000.0  # [m]
POINTS_MAX = 10_000  # points that are geometries together
DASHED = (0, (3, 2))
LOG_BESIDE = -1  # kind of line next to those of the controllers: log replay in an adjacent lane


def overview(run: Run, path: Path) -> None:
    """Draws a run as a PNG of 1600 x 1120 px: the scene at a telling moment, the ego's speed and its logged speed, and
    the number of agents off their logs.

    If the ego crosses an intersection, the scene is a plan view of it with the paths of all agents, above a diagram of
    its signals; else it is the road around the ego, above a space-time diagram of the traffic there.

    Raises:
        InputError: the attached net is not a SUMO net.
        OSError: `path` cannot be written.
    """
    figure = Figure(figsize=(SIZE_PX[0] / DPI, SIZE_PX[1] / DPI), dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    entries, lane_map = run.once(ledger), lane_map_of(run)
    moment = notable_moment(run, entries)
    info = run.info
    what = f"{info.scenario}   ego {info.ego_id} by {info.ego}, background by {info.policy}, seed {info.seed}"
    counts = f"takeovers: {len(entries)}, collisions that are not in the log: {len(run.once(collisions).excess)}"
    figure.suptitle(f"{what}   {counts}", x=0.012, ha="left", fontsize=15, color=INK)
    crossings = crossed(lane_map, _ego_track(run, run.steps)[:, 1:3])
    if lane_map is not None and len(crossings):
        speed, off_log = _intersection(figure, run, moment, lane_map, crossings)
    else:
        grid = figure.add_gridspec(3, 3, height_ratios=(1.15, 1.0, 1.0))
        _bird_view(figure.add_subplot(grid[0, :]), run, moment, lane_map)
        _space_time(figure.add_subplot(grid[1:, :2]), run, moment, lane_map)
        speed = figure.add_subplot(grid[1, 2])
        off_log = figure.add_subplot(grid[2, 2], sharex=speed)
    _speed(speed, run, moment.step)
    _off_log(off_log, run, moment.step)
    figure.savefig(path, dpi=DPI)


def _intersection(
    figure: Figure, run: Run, moment: Moment, lane_map: LaneMap, crossings: FloatArray
) -> tuple[Axes, Axes]:
    """Draws the intersection and its signals; returns axes for the ego's speed and for the agents off their logs."""
    area = Area.around(np.concatenate([_ego_track(run, run.steps)[:, 1:3], crossings]))
    signals = run.signals
    passed = [passage for passage in run.once(run_passages) or [] if passage.agent == run.info.ego_id]
    names = [passage.group for passage in passed]
    every = [] if signals is None else groups_in(signals, area, names)
    groups = every[: max(GROUPS_MAX, len(set(names)))]
    rows = (3.0, 0.55 + 0.16 * len(groups)) if groups else (3.0, 0.01)
    left, right = figure.subfigures(1, 2, width_ratios=(2.0, 1.0))
    grid = left.add_gridspec(2, 1, height_ratios=rows)
    _plan(left.add_subplot(grid[0]), run, moment, lane_map, area)
    if signals is not None and groups:
        axes = left.add_subplot(grid[1])
        draw_signals(axes, signals, groups, run.tables[-1].step)
        for passage in passed:
            row = groups.index(signals.groups.index(passage.group))
            axes.plot(passage.step * run.info.dt, row, "D", color=COLOURS[Controller.EGO], mec="white", ms=9, zorder=5)
        title = f"{len(groups)} of {len(every)} signals" if len(groups) < len(every) else "Signals"
        title += "; the diamond is the ego at the stop line" if passed else ""
        axes.axvline(moment.step * run.info.dt, color=INK, lw=0.9, ls=":")
        _finish(axes, title)
    below = right.add_gridspec(2, 1)
    speed = right.add_subplot(below[0])
    return speed, right.add_subplot(below[1], sharex=speed)


def _plan(axes: Axes, run: Run, moment: Moment, lane_map: LaneMap, area: Area) -> None:
    """Draws the paths of all agents over the intersection, and their boxes at `moment`."""
    table, _ = _at(run, moment.step)
    draw_lanes(axes, lane_map)
    if run.signals is not None:
        draw_stop_lines(axes, run.signals, table.step)
    driven = paths(run.steps.after(run.info.history_steps - 1), area)
    for controller, width, order in ((Controller.LOG, 0.9, 4), (Controller.POLICY, 2.2, 4), (Controller.EGO, 2.8, 5)):
        style = {"colors": COLOURS[controller], "linewidths": width, "zorder": order}
        axes.add_collection(LineCollection(driven[controller], **style))
    logged = _ego_track(run, run.logged)
    axes.plot(logged[:, 1], logged[:, 2], color=INK, lw=1.1, ls=DASHED, zorder=5)
    here = table.take(area.holds(np.stack([table.x, table.y], axis=-1)))
    draw_boxes(axes, here, [COLOURS[Controller(c)] for c in here.controller])
    for row in np.flatnonzero(here.off_log):
        axes.annotate(str(here.id[row]), (here.x[row], here.y[row]), (6, 6), textcoords="offset points", zorder=8)
    frame(axes, area)
    handles = [line_handle(COLOURS[c], f"path: {NAMES[c]}") for c in COLOURS if driven[c]]
    handles.append(line_handle(INK, "ego's log", lw=1.1, ls=DASHED))
    _legend_below(axes, handles)
    none = "" if run.signals is not None else " (no signals are known)"
    _finish(axes, f"{table.step * run.info.dt:.1f} s: {moment.why}{none}")


@dataclass(frozen=True)
class Moment:
    """A step worth looking at, and why."""

    step: int
    why: str


def notable_moment(run: Run, entries: list[LedgerEntry]) -> Moment:
    """Returns the first contact that replay would have had, else the first takeover or contact, else the middle."""
    dt = run.info.dt
    for entry in entries:
        if entry.replay_step is not None and entry.replay_step <= entry.detected_step + entry.held_s / dt:
            other = "the ego" if entry.replay_opponent == run.info.ego_id else f"agent {entry.replay_opponent}"
            step = min(entry.replay_step + LATER, run.tables[-1].step)
            return Moment(step, f"the log of agent {entry.agent} has run into {other}; the agent itself is taken over")
    if entries:
        entry = entries[0]
        middle = entry.detected_step + round(0.5 * entry.held_s / dt)
        return Moment(min(middle, run.tables[-1].step), f"agent {entry.agent} is off its log")
    hits = run.once(collisions)
    for (a, b), step in hits.excess.items():
        return Moment(step, f"agents {a} and {b} touch")
    return Moment(run.tables[len(run.tables) // 2].step, "the middle of the run")


def _at(run: Run, step: int) -> tuple[AgentTable, AgentTable | None]:
    """Returns the agents at the recorded step nearest to `step`, and those of the log."""
    index = int(np.argmin(np.abs(run.steps.step - step)))
    return run.tables[index], run.log[index] if run.log else None


def _bird_view(axes: Axes, run: Run, moment: Moment, lane_map: LaneMap | None) -> None:
    """Draws the road around the ego at a moment, and of agents off their logs their ids, paths and logged boxes."""
    table, logged = _at(run, moment.step)
    view = View.of_ego(table, run.info.ego_id, lane_map)
    draw_traffic(axes, view, table, lane_map)
    for takeover in run.takeovers.get(table.step, []):
        if len(takeover.reference_path):
            axes.plot(*view.seen(takeover.reference_path).T, color=COLOURS[Controller.POLICY], lw=1.2, zorder=2)
            goal = view.seen(np.array(takeover.goal_pose[:2]))
            axes.plot(*goal, marker="x", color=COLOURS[Controller.POLICY], ms=7, zorder=6)
    if logged is not None:
        ghosts = list(view.seen(boxes_of(logged.take(np.isin(logged.id, table.id[table.off_log])))))
        dashed = {"facecolors": "none", "linestyles": DASHED, "linewidths": 1.1}
        axes.add_collection(PolyCollection(ghosts, edgecolors=INK, zorder=5, **dashed))
    low, high = axes.get_ylim()
    for i in np.flatnonzero(table.off_log):
        ahead, left = view.seen(np.array([table.x[i], table.y[i]]))
        if -BEHIND < ahead < AHEAD and low < left < high:  # text beyond the axes would shrink them
            axes.text(ahead, left, str(table.id[i]), ha="center", va="center", fontsize=8, color="white", zorder=7)
    axes.set(xlabel="along the road from the ego [m]", ylabel="to the left [m]")
    handles = legend_handles(np.unique(table.controller).tolist())
    handles.append(Patch(facecolor="none", edgecolor=INK, linestyle=DASHED, label="where the log has it"))
    _legend_below(axes, handles)
    _finish(axes, f"{table.step * run.info.dt:.1f} s: {moment.why}")


def _legend_below(axes: Axes, handles: list[Any]) -> None:
    """Draws a legend below the name of the x axis, however low the axes are."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    anchor = axes.transAxes + ScaledTranslation(0.0, -LEGEND_BELOW_PT / 72.0, figure.dpi_scale_trans)
    place = {"loc": "upper left", "bbox_to_anchor": (0.0, 0.0), "bbox_transform": anchor, "borderaxespad": 0.0}
    axes.legend(handles=handles, ncols=5, frameon=False, fontsize=10, **place)


def _space_time(axes: Axes, run: Run, moment: Moment, lane_map: LaneMap | None) -> None:
    """Draws the paths of the agents in the ego's lane and beside it over time, coloured by controller."""
    steps, route = Steps(run.tables[:: -(-len(run.steps) // DRAWN_MAX)]), _route(run, lane_map)
    table = steps.stacked
    s, d = _along(route, table.x, table.y)
    ego = steps.rows_of(np.array([run.info.ego_id]))[:, 0]
    until = int(np.argmin(ego >= 0)) if (ego < 0).any() else len(ego)  # step from which on the ego is gone
    aside = np.abs(d - d[ego[table.number]])
    near = (aside < BESIDE) & (table.number < until)
    order, follows = tracks(steps)
    follows[1:] &= near[order][1:] & near[order][:-1]
    kind = table.controller.astype(np.int64)
    kind[(kind == Controller.LOG) & (aside > SAME_LANE)] = LOG_BESIDE
    points = np.stack([steps.step[table.number] * run.info.dt, s], axis=-1)
    lines = pieces(points[order], follows, kind[order])
    axes.add_collection(LineCollection(lines.get(LOG_BESIDE, []), colors=FAINT, linewidths=0.8))
    drawn = ((Controller.LOG, 1.4), (Controller.POLICY, 2.4), (Controller.EGO, 2.6))
    for controller, width in drawn:
        segments = lines.get(controller.value, [])
        axes.add_collection(LineCollection(segments, colors=COLOURS[controller], linewidths=width))
    extent = s[ego[:until]]
    ego_log = _ego_track(run, run.logged)
    if len(ego_log):
        axes.plot(ego_log[:, 0], _along(route, ego_log[:, 1], ego_log[:, 2])[0], color=INK, lw=1.1, ls=DASHED)
    handles = [line_handle(COLOURS[c], NAMES[c]) for c in COLOURS if c.value in lines]
    handles.append(line_handle(FAINT, "log replay, lane beside"))
    handles.append(line_handle(INK, "ego's log", lw=1.1, ls=DASHED))
    axes.legend(handles=handles, loc="upper left", fontsize=10, framealpha=0.92, edgecolor="none")
    axes.set(xlim=(0.0, _end(run)), ylim=(min(extent, default=0.0) - AHEAD, max(extent, default=0.0) + AHEAD))
    axes.set(xlabel="time [s]", ylabel="along the ego's lane [m]")
    _mark(axes, run, moment.step)
    _finish(axes, "Traffic in the ego's lane and beside it")


def _route(run: Run, lane_map: LaneMap | None) -> shapely.LineString:
    """Returns the line along which positions are measured: the ego's lane from its first pose, or straight ahead."""
    table = next((t for t in run.tables if t.row(run.info.ego_id) >= 0), run.tables[0])
    row = max(0, table.row(run.info.ego_id))
    x, y, yaw = (values[row : row + 1] for values in (table.x, table.y, table.yaw))
    if lane_map is not None:
        place = lane_map.nearest(x, y, yaw)
        return shapely.LineString(lane_map.path_from(int(place.lane[0]), 0.0, ROUTE_MAX))
    end = (x[0] + ROUTE_MAX * np.cos(yaw[0]), y[0] + ROUTE_MAX * np.sin(yaw[0]))
    return shapely.LineString([(x[0], y[0]), end])


def _along(route: shapely.LineString, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns positions of points along `route`, and their distances to its left [m]."""
    if len(x) > POINTS_MAX:
        cuts = range(POINTS_MAX, len(x), POINTS_MAX)
        parts = [_along(route, *part) for part in zip(np.split(x, cuts), np.split(y, cuts), strict=True)]
        s, left = np.concatenate(parts, axis=1)
        return s, left
    points = shapely.points(x, y)
    s = shapely.line_locate_point(route, points)
    foot, ahead = shapely.line_interpolate_point(route, s), shapely.line_interpolate_point(route, s + 1.0)
    (fx, fy), (ax, ay) = shapely.get_coordinates(foot).T, shapely.get_coordinates(ahead).T
    _, left = to_body(x - fx, y - fy, np.arctan2(ay - fy, ax - fx))
    return s, left


def _ego_track(run: Run, steps: Steps) -> FloatArray:
    """Returns (k, 4) time [s], x, y [m] and speed [m/s] of the ego in the run or in its log."""
    own = steps.once(Steps.only, (run.info.ego_id,))
    rows, table = own.track(run.info.ego_id), own.stacked
    time = steps.step[table.number[rows]] * run.info.dt
    return np.column_stack([time, table.x[rows], table.y[rows], table.speed[rows]])


def _speed(axes: Axes, run: Run, step: int) -> None:
    driven, logged = (_ego_track(run, steps) for steps in (run.steps, run.logged))
    axes.plot(logged[:, 0], logged[:, 3], color=INK, lw=1.1, ls=DASHED, label="log")
    axes.plot(driven[:, 0], driven[:, 3], color=COLOURS[Controller.EGO], lw=2.0, label=f"ego ({run.info.ego})")
    axes.set_ylim(bottom=0.0)
    axes.set(ylabel="speed [m/s]")
    axes.legend(loc="best", frameon=False, fontsize=10)
    _mark(axes, run, step)
    _finish(axes, "Speed of the ego")


def _off_log(axes: Axes, run: Run, step: int) -> None:
    times = run.steps.step * run.info.dt
    counts = np.array([int(table.of_policy.sum()) for table in run.tables])
    axes.stackplot(times, counts, colors=[COLOURS[Controller.POLICY]], alpha=0.85, step="post")
    excess = [first * run.info.dt for first in run.once(collisions).excess.values()]
    if excess:
        axes.plot(excess, np.zeros(len(excess)), "v", color=COLOURS[Controller.EGO], ms=8, clip_on=False)
        handle = line_handle(COLOURS[Controller.EGO], "collision not in the log", marker="v", ls="")
        axes.legend(handles=[handle], loc="upper left", frameon=False, fontsize=10)
    axes.set(xlim=(0.0, _end(run)), xlabel="time [s]", ylabel="agents")
    axes.set_ylim(0.0, max(1.0, 1.15 * float(counts.max())))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    _mark(axes, run, step)
    _finish(axes, "Background off its log")


def _end(run: Run) -> float:
    """Returns the time [s] of the last recorded step, at least that of step 1, so that the time axis is never empty."""
    return max(run.tables[-1].step, 1) * run.info.dt


def _mark(axes: Axes, run: Run, step: int) -> None:
    """Marks the history, and the moment of the scene."""
    axes.axvspan(0.0, run.info.history_steps * run.info.dt, color="#f4f5f7", zorder=0)
    axes.axvline(step * run.info.dt, color=INK, lw=0.9, ls=":")


def _finish(axes: Axes, title: str) -> None:
    """Gives axes a title, and lines and ticks that do not catch the eye."""
    axes.set_title(title, loc="left", fontsize=12, color=INK)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#9aa0a8")
    axes.tick_params(colors=INK, labelsize=10)
