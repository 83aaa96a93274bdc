"""All data of the player, packed."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import shapely

from litsim_data.surrogates.safety import TTC_CRITICAL_S, following, safety_series
from litsim_eval.analysis.measure import Metrics, Span
from litsim_eval.analysis.measures.comfort import BOUNDS, motion_values
from litsim_eval.analysis.metrics import measures
from litsim_eval.report.forecasts import Forecasts
from litsim_eval.report.packing import Packer
from litsim_eval.report.plans import NO_PLANS, Plans
from litsim_eval.report.tracks import Tracks, ghosts_of, tracks_of
from litsim_sim.core.colours import LIGHT_NAMES, Mode
from litsim_sim.core.scene import Controller, FloatArray, Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.core.takeover import Takeover
from litsim_sim.lane_map.net_lanes import Lane
from litsim_sim.lane_map.signal_links import stop_line_parts
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

METRE, RADIAN, SPEED, SIGMA = 0.01, 0.002, 0.01, 0.05  # resolutions
SIMPLIFY = 0.05  # [m] tolerance of the outline of the road
SURROUNDINGS = 150.0  # [m] of road beyond where agents drive
ORIGIN_GRID = 1000.0  # [m]
TTC_MAX = 12.0  # [s] largest time to collision that is plotted
HEADWAY_MAX = 6.0  # [s] largest headway that is plotted
COMFORT = {"acceleration": "longitudinal_acceleration", "jerk": "longitudinal_jerk", "yaw_rate": "yaw_rate"}
"""Series of the ego with their names in :data:`litsim_eval.analysis.measures.comfort.BOUNDS`."""
ON_LOG = 0.005  # [m]


def pack_run(run: Run, metrics: dict[str, Any], forecasts: Forecasts, every: int, plans: Plans = NO_PLANS) -> str:
    """Returns the run as a container of :mod:`litsim_eval.report.packing`, with forecasts `every` so many steps."""
    tracks, ghosts = run.once(tracks_of), ghosts_of(run)
    origin = origin_of(tracks)
    packer = Packer(
        {
            "run": {
                "id": run.info.run_id,
                "ego": run.info.ego_id,
                "ego_by": run.info.ego,
                "dt": run.info.dt,
                "first": tracks.first,
                "frames": tracks.frames,
                "history": run.info.history_steps,
                "origin": origin.tolist(),
            },
            "agents": _identities(tracks),
            "ghosts": ghosts.id.tolist(),
            "road": road(run, tracks, origin),
            "signals": signals(run, tracks, origin),
            **_takeovers(run, tracks, origin),
            "contacts": metrics["collision"]["contacts"],
            "moments": moments(run, metrics),
            "bounds": {"ttc": [TTC_CRITICAL_S[0]], **{name: BOUNDS[bound] for name, bound in COMFORT.items()}},
            "series": _series(run, tracks, ghosts),
            "forecast": {"time": np.round(forecasts.time, 3).tolist(), "every": every},
            "plan": {"topic": plans.topic, "stop": plans.stop.tolist()},
        }
    )
    packer.add("mode", tracks.mode, differences=1)
    _add_motion(packer, "", tracks, ("x", "y", "yaw", "speed", "acceleration"), origin)
    packer.add("ghost_present", ghosts.present, differences=1)
    _add_motion(packer, "ghost_", ghosts, ("x", "y", "yaw", "speed"), origin)
    packer.add("forecast_agent", np.searchsorted(tracks.id, forecasts.agent), differences=1)
    packer.add("forecast_step", forecasts.step, differences=1)
    for axis, name in enumerate("xy"):
        packer.add(f"forecast_{name}", forecasts.mean[..., axis] - origin[axis], 5.0 * METRE, differences=2)
    for axis, name in enumerate(("sigma_x", "sigma_y", "rho")):
        packer.add(f"forecast_{name}", forecasts.spread[..., axis], SIGMA, differences=1)
    packer.add("plan_step", plans.step, differences=1)
    packer.add("plan_end", plans.end, differences=1)
    for axis, name in enumerate("xy"):
        packer.add(f"plan_{name}", plans.place[..., axis] - origin[axis], 5.0 * METRE, differences=2)
    return packer.pack()


def origin_of(tracks: Tracks) -> FloatArray:
    """Returns the place (2,) in frame map from which the page measures all others [m]: the nearest kilometre.

    Browsers draw in single precision, which is half a metre 5000 km from the origin, as UTM's northings are.
    """
    present = tracks.present
    middle = np.array([np.median(tracks.x[present]), np.median(tracks.y[present])]) if present.any() else np.zeros(2)
    return np.asarray(np.round(middle / ORIGIN_GRID) * ORIGIN_GRID)


def road(run: Run, tracks: Tracks, origin: FloatArray) -> dict[str, Any]:
    """Returns surfaces and painted lines of lanes near the agents: flat lists x0, y0, x1, y1, ... from `origin` [m]."""
    lane_map = lane_map_of(run)
    present = tracks.present
    if lane_map is None or not present.any():
        return {"lanes": [], "lines": []}
    x, y = tracks.x[present], tracks.y[present]
    area = shapely.box(*(v - SURROUNDINGS for v in (x.min(), y.min())), *(v + SURROUNDINGS for v in (x.max(), y.max())))
    near = [lane for lane in lane_map.lanes if area.intersects(shapely.LineString(lane.centerline))]
    lanes = [{"width": lane.width, "line": _flat(shapely.LineString(lane.centerline), origin)} for lane in near]
    return {"lanes": lanes, "lines": [line for lane in near if not lane.is_internal for line in _lines(lane, origin)]}


def signals(run: Run, tracks: Tracks, origin: FloatArray) -> list[dict[str, Any]]:
    """Stops lines: for each controlled connection its part of the line, from `origin` [m], and its signal by frame.

    The connections of a lane share its line from left to right, as they turn. `shown` lists [frame, light] of every
    change; lights are those of LIGHT_NAMES.
    """
    if run.signals is None:
        return []
    frames = np.arange(tracks.first, tracks.first + tracks.frames)
    frames = frames[frames < run.signals.states.shape[1]]
    lines = []
    parts = stop_line_parts(run.signals.links) - origin
    for ends, group in zip(parts, run.signals.link_group.tolist(), strict=True):
        lights = [LIGHT_NAMES[SignalState(state)] for state in run.signals.states[group, frames].tolist()]
        shown = [[k, light] for k, light in enumerate(lights) if k == 0 or light != lights[k - 1]]
        lines.append({"line": np.round(ends.ravel(), 2).tolist(), "shown": shown})
    return lines


def _lines(lane: Lane, origin: FloatArray) -> list[dict[str, Any]]:
    """Returns the right border, dashed where a lane of the same edge lies beyond, and the left one where none does."""
    sides = [(-0.5, lane.right is not None)] + ([(0.5, False)] if lane.left is None else [])
    borders = []
    for side, dashed in sides:
        border = shapely.LineString(lane.centerline).offset_curve(side * lane.width)
        parts = [part for part in shapely.get_parts(border) if part.geom_type == "LineString" and not part.is_empty]
        borders += [{"dashed": dashed, "line": _flat(part, origin)} for part in parts]
    return borders


def _flat(line: shapely.LineString, origin: FloatArray) -> list[float]:
    points: FloatArray = np.asarray(line.simplify(SIMPLIFY).coords)[:, :2] - origin
    return [float(v) for v in np.round(points, 2).ravel()]


def _identities(tracks: Tracks) -> list[dict[str, Any]]:
    names = {kind.value: kind.name.lower() for kind in Kind}
    columns = (tracks.id, tracks.kind, tracks.length, tracks.width)
    return [
        {"id": agent, "kind": names.get(kind, "unknown"), "length": round(length, 2), "width": round(width, 2)}
        for agent, kind, length, width in zip(*(column.tolist() for column in columns), strict=True)
    ]


def _add_motion(packer: Packer, prefix: str, tracks: Tracks, names: tuple[str, ...], origin: FloatArray) -> None:
    zero = dict(zip("xy", origin.tolist(), strict=True))
    form = {"x": (METRE, 2), "y": (METRE, 2), "yaw": (RADIAN, 1), "speed": (SPEED, 1), "acceleration": (SPEED, 1)}
    for name in names:
        resolution, differences = form[name]
        packer.add(prefix + name, getattr(tracks, name) - zero.get(name, 0.0), resolution, differences)


def _takeovers(run: Run, tracks: Tracks, origin: FloatArray) -> dict[str, Any]:
    """Returns agents off their logs by frame, and the reference paths, which the entries name by index."""
    paths: dict[bytes, int] = {}
    frames: list[list[dict[str, Any]]] = [[] for _ in range(tracks.frames)]
    lines: list[list[float]] = []
    for step, records in run.takeovers.items():
        if not 0 <= step - tracks.first < tracks.frames:
            continue
        for record in records:
            key = record.reference_path.tobytes()
            if key not in paths:
                paths[key] = len(lines)
                usable = len(record.reference_path) > 1 and np.isfinite(record.reference_path).all()
                lines.append(_flat(shapely.LineString(record.reference_path), origin) if usable else [])
            frames[step - tracks.first].append(_takeover(record, paths[key], origin))
    return {"takeovers": frames, "paths": lines}


def _takeover(record: Takeover, path: int, origin: FloatArray) -> dict[str, Any]:
    pose, goal = (np.array(place) - [*origin, 0.0] for place in (record.conflict_pose, record.goal_pose))
    return {
        "agent": record.agent,
        "opponent": record.opponent,
        "state": record.state.name.lower(),
        "reason": record.reason.name.lower(),
        "detected": record.detected_step,
        "ttc": _plain(record.time_to_conflict) if record.predicted else None,
        "probability": _plain(record.overlap_probability) if record.predicted else None,
        "pose": [_plain(v, 3) for v in pose] if np.isfinite(pose).all() else None,
        "goal": [_plain(v) for v in goal[:2]] if np.isfinite(goal).all() else None,
        "path": path,
        "residual": _plain(record.residual_position) if record.residual_position >= 0 else None,
    }


def _series(run: Run, tracks: Tracks, ghosts: Tracks) -> dict[str, Any]:
    ego_ttc, others_ttc = times_to_leader(run, tracks.first, tracks.frames)
    ego = run.info.ego_id
    far = zip(ghosts.id.tolist(), deviations(tracks, ghosts), strict=True)
    return {
        "speed": _values(speeds(tracks, ego)),
        "speed_log": _values(speeds(ghosts, ego)),
        "ttc_ego": _values(ego_ttc),
        "ttc_others": _values(others_ttc),
        **{name: _values(series) for name, series in _comfort(run, tracks).items()},
        "deviation": {str(agent): _values(values) for agent, values in far if agent != ego},
        "policy": _values(counts(tracks, Mode.POLICY)),
        "own": _values(counts(tracks, Mode.OWN_INTENT)),
        "handback": _values(counts(tracks, Mode.HANDBACK)),
    }


def _comfort(run: Run, tracks: Tracks) -> dict[str, FloatArray]:
    """Returns acceleration [m/s2], jerk along the way [m/s3], yaw rate [rad/s] and headway [s] of the ego by frame."""
    rows, table = run.steps.track(run.info.ego_id), run.steps.stacked
    frame = run.steps.step[table.number[rows]] - tracks.first
    values = motion_values(table.speed[rows], table.acceleration[rows], table.yaw_rate[rows], run.info.dt)
    series = {name: np.full(tracks.frames, np.nan) for name in (*COMFORT, "headway")}
    for name, bound in COMFORT.items():
        series[name][frame[len(frame) - len(values[bound]) :]] = values[bound]
    headway = safety_series(run.steps, run.info.ego_id).headway
    series["headway"][frame] = np.where(headway <= HEADWAY_MAX, headway, np.nan)
    return series


def _values(series: FloatArray) -> list[float | None]:
    return [_plain(v) for v in series.tolist()]


def _plain(value: float, digits: int = 2) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None


def speeds(tracks: Tracks, agent: int) -> FloatArray:
    """Returns the speed of `agent` at every step (frames,) [m/s]."""
    row = tracks.row(agent)
    return np.full(tracks.frames, np.nan) if row < 0 else np.where(tracks.present[row], tracks.speed[row], np.nan)


def deviations(tracks: Tracks, logged: Tracks) -> FloatArray:
    """Returns (agents of `logged`, frames) distance of each from its log [m]; NaN while it follows its log exactly."""
    out = np.full(logged.present.shape, np.nan)
    for i, agent in enumerate(logged.id.tolist()):
        j = tracks.row(agent)
        if j >= 0:
            far = np.hypot(tracks.x[j] - logged.x[i], tracks.y[j] - logged.y[i])
            apart = (far > ON_LOG) | (tracks.mode[j] != Mode.LOG)
            out[i] = np.where(tracks.present[j] & logged.present[i] & apart, far, np.nan)
    return out


def times_to_leader(run: Run, first: int, frames: int) -> tuple[FloatArray, FloatArray]:
    """Returns the time to collision [s] with the leader: of the ego, and the smallest among agents off their logs.

    The leader is that of :func:`litsim_data.surrogates.safety.following`; both keep their speeds. NaN where there is no
    leader, the gap does not close, or the time exceeds TTC_MAX.
    """
    ego, others = np.full((2, frames), np.inf)
    for part in run.steps.parts():
        table = part.stacked
        driven = np.flatnonzero(table.off_log)
        ttc, is_ego = following(table, driven).time_to_leader, table.controller[driven] == Controller.EGO
        frame = part.step[table.number[driven]] - first
        for series, chosen in ((ego, is_ego), (others, ~is_ego)):
            np.minimum.at(series, frame[chosen], ttc[chosen])
    return np.where(ego <= TTC_MAX, ego, np.nan), np.where(others <= TTC_MAX, others, np.nan)


def counts(tracks: Tracks, mode: int) -> FloatArray:
    """Returns the number of agents in a mode of :class:`litsim_sim.core.colours.Mode`."""
    return np.asarray((tracks.mode == mode).sum(axis=0), np.float64)


def moments(run: Run, metrics: Metrics) -> dict[str, list[Span]]:
    """Returns the spans of steps at which the ego does what each field counts against it; fields without are left out.

    Of the smallest time to collision it is the step of the smallest.
    """
    spans: dict[str, list[Span]] = {}
    for measure in measures():
        with suppress(KeyError, TypeError):  # no signals, or measures by an earlier version
            spans[measure.name] = list(measure.moments(run, metrics)) if measure.moments else []
    return {field: missed for field, missed in spans.items() if missed}
