"""Centre lines of NGSIM's CAD drawings, to check nets against; nothing of them goes into a net.

The text files that circulate hold, after ``CENTERLINES`` and their number, for each line the word ``CENTERLINE``, a
name, the number of points, and the points in State Plane feet.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely

from litsim_data.ngsim.sites import FOOT, SITES, Site
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.io.yaml_input import read_text


@dataclass(frozen=True)
class CenterLine:
    """A centre line of the CAD drawing: its name, and its `points` (k, 2) [m]."""

    name: str
    points: FloatArray


def read_center_lines(path: Path, site: Site | None = None) -> tuple[list[CenterLine], Site]:
    """Returns the lines of the file at `path` in frame map of the site on which they lie.

    Args:
        path: the file.
        site: on which they lie; if not given, found by position.

    Raises:
        InputError: the file is missing or malformed, or lies on no known site.
    """
    lines = [line.strip() for line in read_text(path).splitlines() if line.strip()]
    if not lines or lines[0] != "CENTERLINES":
        raise InputError(f"{path}: not a file of CAD centre lines: it does not begin with the line CENTERLINES")
    center_lines, at = [], 2
    while at < len(lines):
        try:
            line = _center_line(lines[at:])
        except (ValueError, IndexError) as error:
            raise InputError(f"{path}: line {at + 1}: not a centre line: {error}") from error
        center_lines.append(line)
        at += 3 + len(line.points)
    if not center_lines:
        raise InputError(f"{path}: no centre lines")
    site = site or _site_of(center_lines, path)
    return [CenterLine(line.name, np.column_stack(site.map_from_global(*line.points.T))) for line in center_lines], site


def _center_line(lines: list[str]) -> CenterLine:
    """Returns the line at the beginning of `lines`, in metres; ValueError or IndexError if it is malformed."""
    if lines[0] != "CENTERLINE":
        raise ValueError(f"expected CENTERLINE, found {lines[0]!r}")
    name, count = lines[1], int(lines[2])
    points = np.array([[float(value) for value in line.split()] for line in lines[3 : 3 + count]])
    if points.shape != (count, 2) or count < 2:
        raise ValueError(f"{name}: expected {count} points of two coordinates")
    return CenterLine(name, FOOT * points)


def distance_to_lines(points: FloatArray, lines: list[CenterLine]) -> tuple[FloatArray, IntArray, BoolArray]:
    """Measures the distance of points (n, 2) to the nearest of `lines`.

    Returns:
        (n,) distances [m], (n,) positions of that line in `lines`, and (n,) whether the nearest point is on the line
        rather than at one of its ends.
    """
    places, curves = shapely.points(points), [shapely.LineString(line.points) for line in lines]
    distances = np.array([shapely.distance(curve, places) for curve in curves])
    nearest = distances.argmin(axis=0)
    along = np.array([shapely.line_locate_point(curve, places) for curve in curves])[nearest, np.arange(len(points))]
    length = np.array([curve.length for curve in curves])[nearest]
    return distances.min(axis=0), nearest, (along > 0.0) & (along < length)


def _site_of(lines: list[CenterLine], path: Path) -> Site:
    # US-101 and Lankershim are neighbours: the one whose anchor is nearer.
    points = np.concatenate([line.points for line in lines])
    by_distance = {float(np.hypot(*(points - np.array(site.global_anchor)).T).min()): site for site in SITES.values()}
    nearest = min(by_distance)
    site = by_distance[nearest]
    if not site.holds(points[:, 0], points[:, 1]).any():
        raise InputError(f"{path}: the centre lines lie on none of the sites {sorted(SITES)}")
    return site
