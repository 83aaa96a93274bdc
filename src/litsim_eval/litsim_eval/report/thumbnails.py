"""Thumbnail of a run: the agents at the most telling moment, in a few hundred bytes of integers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from litsim_data.surrogates.safety import safety_series
from litsim_eval.report.tracks import Tracks, tracks_of
from litsim_sim.core.colours import Mode
from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import FloatArray
from litsim_sim.core.steps import Steps
from litsim_sim.io.files import write_text
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

THUMBNAIL_FILE = "thumbnail.json"
FORMAT = 1
AHEAD_M, BESIDE_M = 33.0, 11.0  # distance of the edges from the middle of the picture
BEYOND_M = 5.0  # distance beyond the edge within which boxes and lines are kept, as they may reach in
UNIT_M, UNIT_RAD = 0.1, 0.01  # units of the integers
ROAD_TOLERANCE_M, PATH_TOLERANCE_M = 0.3, 0.2
SEAM_M = 0.2  # by which lanes are widened to either side, to close gaps between them
AFTER_DETECTION = 10  # [steps] after which a takeover is visible


def thumbnail_of(run: Run, metrics: dict[str, Any]) -> dict[str, Any]:
    """Returns a scene of the run, of at least one step, around the ego, seen from above, driving to the right.

    Returns:
        Values for JSON: `step` and `what` it shows; `size`, half length and half height of the picture; `road`, a list
        of outlines and holes; `boxes`, one [x, y, yaw, length, width, mode] for each agent; `path` of the ego, and
        `log`, its logged one; `contact`, the place of the contact or None. Places are flat lists of integers, x to the
        right and y up from the middle of the picture, in :data:`UNIT_M` and :data:`UNIT_RAD`; modes are those of
        :class:`litsim_sim.core.colours.Mode`.
    """
    moment, tracks = _moment(run, metrics), run.once(tracks_of)
    frame = int(np.clip(moment.step - tracks.first, 0, tracks.frames - 1))
    head = {
        "format": FORMAT,
        "step": moment.step,
        "what": moment.what,
        "size": [round(extent / UNIT_M) for extent in (AHEAD_M, BESIDE_M)],
    }
    row = _focus(tracks, run.info.ego_id, moment.agents, frame)
    if row < 0:
        return head | {"road": [], "boxes": [], "path": [], "log": [], "contact": None}
    pose = (float(tracks.x[row, frame]), float(tracks.y[row, frame]), float(tracks.yaw[row, frame]))
    window = shapely.box(-AHEAD_M - BEYOND_M, -BESIDE_M - BEYOND_M, AHEAD_M + BEYOND_M, BESIDE_M + BEYOND_M)
    return head | {
        "road": _road(run, pose, window),
        "boxes": _boxes(tracks, frame, pose, window),
        "path": _path(run.steps, run.info.ego_id, pose, window),
        "log": _path(run.logged, run.info.ego_id, pose, window),
        "contact": _contact(tracks, moment.agents, frame, pose) if moment.contact else None,
    }


def write_thumbnail(run: Run, metrics: dict[str, Any], folder: Path) -> None:
    """Writes the picture of a run into `folder`, for the page of a campaign.

    Raises:
        InputError: it cannot be written.
    """
    text = json.dumps(thumbnail_of(run, metrics), allow_nan=False, separators=(",", ":"))
    write_text(folder / THUMBNAIL_FILE, text)


def read_thumbnail(folder: Path) -> dict[str, Any] | None:
    """Returns the picture of a run written by :func:`write_thumbnail`; None without one of the current format."""
    try:
        picture = json.loads((folder / THUMBNAIL_FILE).read_text())
    except (OSError, ValueError):
        return None
    return picture if isinstance(picture, dict) and picture.get("format") == FORMAT else None


class _Moment(NamedTuple):
    """Moment of a picture: the step, what happens, the agents concerned, and whether they touch."""

    step: int
    what: str
    agents: tuple[int, ...] = ()
    contact: bool = False


def _moment(run: Run, metrics: dict[str, Any]) -> _Moment:
    """Returns the first contact that is not in the log, the ego's if any, else a takeover or the ego's shortest TTC."""
    ego, last = run.info.ego_id, run.tables[-1].step
    touching = [(c["step"], tuple(c["pair"])) for c in metrics["collision"]["contacts"] if not c["in_log"]]
    for step, pair in sorted(touching, key=lambda contact: (ego not in contact[1], contact[0])):
        return _Moment(step, f"agents {pair[0]} and {pair[1]} touch", pair, contact=True)
    for entry in metrics["ledger"]:
        step = min(entry["detected_step"] + AFTER_DETECTION, last)
        return _Moment(step, f"agent {entry['agent']} is taken over", (entry["agent"],))
    near = safety_series(run.simulated, ego)
    if np.isfinite(near.ttc).any():
        return _Moment(int(near.step[np.argmin(near.ttc)]), "the ego's shortest time to collision")
    return _Moment(run.tables[len(run.tables) // 2].step, "the middle of the run")


def _focus(tracks: Tracks, ego: int, agents: tuple[int, ...], frame: int) -> int:
    """Returns the row of the agent in the centre: the ego, unless it is far from the first of `agents`; -1 for none."""
    rows = [tracks.row(agent) for agent in (ego, *agents[:1])]
    here = [row for row in rows if row >= 0 and tracks.mode[row, frame] != Mode.ABSENT]
    if len(here) == 2:
        apart = np.hypot(*(values[here[0], frame] - values[here[1], frame] for values in (tracks.x, tracks.y)))
        return here[0] if apart < AHEAD_M else here[1]
    return here[0] if here else -1


def _road(run: Run, pose: tuple[float, float, float], window: shapely.Polygon) -> list[list[int]]:
    """Returns outlines and holes of the road's surface inside the window."""
    lane_map = lane_map_of(run)
    if lane_map is None:
        return []
    reach = float(np.hypot(AHEAD_M + BEYOND_M, BESIDE_M + BEYOND_M))
    around = shapely.Point(pose[:2]).buffer(reach)
    near = [lane for lane in lane_map.lanes if around.intersects(shapely.LineString(lane.centerline))]
    surfaces = [
        shapely.LineString(lane.centerline).buffer(0.5 * lane.width + SEAM_M, cap_style="flat") for lane in near
    ]
    # cut out in frame map: what is turned is rounded, and may then be no surface that can be cut
    framed = shapely.transform(window, lambda points: _in_map(points, pose))
    part = shapely.union_all(surfaces).intersection(framed).simplify(ROAD_TOLERANCE_M)
    parts = shapely.get_parts(shapely.transform(part, lambda points: _in_view(points, pose)))
    rings = [
        ring
        for part in parts
        if part.geom_type == "Polygon"
        for ring in (part.exterior, *part.interiors)
        if ring.length
    ]
    return [_whole(np.asarray(ring.coords)) for ring in rings]


def _boxes(tracks: Tracks, frame: int, pose: tuple[float, float, float], window: shapely.Polygon) -> list[list[int]]:
    here = np.flatnonzero(tracks.present[:, frame])
    places = _in_view(np.column_stack([tracks.x[here, frame], tracks.y[here, frame]]), pose)
    inside = shapely.contains_xy(window, places[:, 0], places[:, 1])
    boxes = []
    for row, (x, y) in zip(here[inside], places[inside], strict=True):
        yaw = (tracks.yaw[row, frame] - pose[2] + np.pi) % (2.0 * np.pi) - np.pi
        metres = (round(float(v) / UNIT_M) for v in (tracks.length[row], tracks.width[row]))
        turned = round(float(yaw) / UNIT_RAD)
        boxes.append([*_whole(np.array([[x, y]])), turned, *metres, int(tracks.mode[row, frame])])
    return boxes


def _path(steps: Steps, agent: int, pose: tuple[float, float, float], window: shapely.Polygon) -> list[list[int]]:
    """Returns where an agent goes in the window, as lines."""
    rows, table = steps.track(agent), steps.stacked
    places = np.column_stack([table.x[rows], table.y[rows]])
    if len(places := places[np.isfinite(places).all(axis=1)]) < 2:
        return []
    line = shapely.LineString(_in_view(places, pose))
    parts = shapely.get_parts(line.intersection(window).simplify(PATH_TOLERANCE_M))
    return [_whole(np.asarray(part.coords)) for part in parts if part.geom_type == "LineString" and part.length > 0]


def _contact(tracks: Tracks, agents: tuple[int, ...], frame: int, pose: tuple[float, float, float]) -> list[int] | None:
    """Returns the point half way between the agents that touch."""
    rows = [tracks.row(agent) for agent in agents]
    if not rows or min(rows) < 0:
        return None
    middle = [float(np.mean(values[rows, frame])) for values in (tracks.x, tracks.y)]
    return _whole(_in_view(np.array([middle]), pose))


def _in_map(points: FloatArray, pose: tuple[float, float, float]) -> FloatArray:
    """Returns points (n, 2) in frame map of points relative to a pose; the inverse of :func:`_in_view`."""
    x, y, yaw = pose
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.column_stack([x + cos * points[:, 0] - sin * points[:, 1], y + sin * points[:, 0] + cos * points[:, 1]])


def _in_view(points: FloatArray, pose: tuple[float, float, float]) -> FloatArray:
    """Returns points (n, 2) in frame map relative to a pose: x ahead, y to the left [m]."""
    return np.column_stack(to_body(points[:, 0] - pose[0], points[:, 1] - pose[1], np.asarray(pose[2])))


def _whole(points: FloatArray) -> list[int]:
    return [int(v) for v in np.round(points[:, :2] / UNIT_M).ravel()]
