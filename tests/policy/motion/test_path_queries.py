"""Compiled loops over polylines against plain numpy that looks at every segment, bit for bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.motion.path_batch import CHUNK, UNIT_X, UNIT_Y, PathBatch, S, X, thinned, windows
from litsim_policy.motion.reference_path import ReferencePath, window
from made_lanes import polylines


def along(line: np.ndarray) -> np.ndarray:
    """Arc lengths of the points."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])


def nearest(line: np.ndarray, x: float, y: float) -> tuple[int, float, float]:
    """Segment, arc length and offset of the nearest point of a line with prolonged ends."""
    s = along(line)
    length = np.diff(s)
    unit = np.diff(line, axis=0) / length[:, None]
    dx, dy = x - line[:-1, 0], y - line[:-1, 1]
    low, high = np.zeros(len(length)), length.copy()
    low[0], high[-1] = -np.inf, np.inf
    t = np.clip(dx * unit[:, 0] + dy * unit[:, 1], low, high)
    best = int(np.argmin((dx - t * unit[:, 0]) ** 2 + (dy - t * unit[:, 1]) ** 2))
    return best, float(s[best] + t[best]), float(unit[best, 0] * dy[best] - unit[best, 1] * dx[best])


def places(paths: PathBatch, path: np.ndarray, x: np.ndarray, y: np.ndarray) -> list[tuple[int, float, float]]:
    """Segments, arc lengths and offsets of the nearest points."""
    at = paths.project(path, x, y)
    return list(zip(at.segment.tolist(), at.s.tolist(), at.d.tolist(), strict=True))


@given(polylines())
def test_the_layout_is_points_arc_lengths_and_directions_and_circles_hold_their_chunks(lines) -> None:
    segments, circles, count = PathBatch.of(lines)
    for p, (line, n) in enumerate(zip(lines, count, strict=True)):
        steps, s = np.diff(line, axis=0), along(line)
        assert (segments[p, :n, X : X + 2] == line).all()
        assert (segments[p, :n, S] == s).all()
        assert (segments[p, : n - 1, UNIT_X : UNIT_Y + 1] == steps / np.diff(s)[:, None]).all()
        for c in range(-(-(n - 1) // CHUNK)):
            x, y, radius = circles[p, c]
            away = np.hypot(*(line[c * CHUNK : (c + 1) * CHUNK + 1] - [x, y]).T)
            assert away.max() == pytest.approx(radius)


@given(polylines(), st.integers(0, 2**32))
def test_the_nearest_point_is_the_first_of_the_nearest_of_all_segments(lines, seed: int) -> None:
    random = np.random.default_rng(seed)
    paths = PathBatch.of(lines)
    path = random.integers(0, len(lines), 60)
    x, y = random.normal(0.0, 50.0, (2, 60))
    for k in range(20):  # vertices, where two segments are equally near and rounding could decide
        x[k], y[k] = lines[path[k]][random.integers(0, len(lines[path[k]]))]
    assert places(paths, path, x, y) == [nearest(lines[p], *place) for p, *place in zip(path, x, y, strict=True)]


def test_far_away_places_are_nearest_to_what_is_prolonged() -> None:
    """A line that comes back: its prolonged ends are nearer than all chunks between them."""
    angle = np.linspace(0.0, np.pi, 40)
    line = 30.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    x, y = np.array([30.5, -30.5, 29.0, -29.0]), np.full(4, -500.0)
    found = places(PathBatch.of([line]), np.zeros(4, np.int64), x, y)
    expected = [nearest(line, *place) for place in zip(x, y, strict=True)]
    assert found == expected and [segment for segment, *_ in expected] == [0, 38, 0, 38]


@given(polylines(), st.lists(st.floats(-20.0, 200.0), min_size=1, max_size=8))
def test_segments_and_points_at_arc_lengths(lines, lengths: list[float]) -> None:
    paths = PathBatch.of(lines)
    lengths = [*lengths, *along(lines[0])[:3].tolist()]
    for p, line in enumerate(lines):
        s = along(line)
        found = paths.segment(np.array(lengths), np.full(len(lengths), p))
        assert found.tolist() == np.clip(np.searchsorted(s, lengths, side="right") - 1, 0, len(s) - 2).tolist()
    for length in lengths:
        points = paths.point(np.full(len(lines), length))
        for p, line in enumerate(lines):
            s, unit = along(line), paths.segments[p, :, UNIT_X : UNIT_Y + 1]
            if length <= 0.0:
                expected = line[0] + length * unit[0]
            elif length >= s[-1]:
                expected = line[-1] + (length - s[-1]) * unit[len(line) - 2]
            else:
                expected = np.array([np.interp(length, s, line[:, axis]) for axis in (0, 1)])
            assert (points[p] == expected).all()


@given(polylines(), st.floats(-20.0, 100.0), st.floats(0.0, 10.0), st.floats(0.0, 30.0))
def test_windows_hold_what_is_around_an_arc_length_and_the_segments_there(lines, s, behind, ahead) -> None:
    begin, end = windows(PathBatch.of(lines), np.full(len(lines), s), behind, ahead)
    for p, line in enumerate(lines):
        lengths, last = along(line), len(line) - 2
        here, there = (np.clip(np.searchsorted(lengths, at, side="right") - 1, 0, last) for at in (s, s + ahead))
        first = min(int(np.searchsorted(lengths, s - behind)), int(here))
        assert (begin[p], end[p]) == (first, there + 2)


def test_a_window_of_a_road_that_goes_straight_on_for_long_begins_where_the_agent_is() -> None:
    """Between two vertices that are farther apart than a window is long, before a bend."""
    path = ReferencePath(np.array([[0.0, 0.0], [10.0, 0.0], [500.0, 0.0], [510.0, 8.0]]))
    seen = window(path, 250.0, 1.0)
    assert seen.points.tolist() == [[10.0, 0.0], [500.0, 0.0]]
    s, d = seen.project(np.array([250.0]), np.array([1.0]))
    assert s[0] == 240.0 and d[0] == 1.0
    near_the_bend = window(path, 400.0, 0.0)
    assert near_the_bend.points[-1].tolist() == [510.0, 8.0], "beyond the vertex the road goes elsewhere"


@given(polylines(), st.floats(0.1, 8.0))
def test_thinned_lines_keep_the_first_point_and_whatever_is_far_enough_from_the_last_kept(lines, spacing) -> None:
    kept = [0]
    for k, point in enumerate(lines[0]):
        if np.hypot(*(point - lines[0][kept[-1]])) >= spacing:
            kept.append(k)
    assert thinned(lines[0], spacing).tolist() == kept
