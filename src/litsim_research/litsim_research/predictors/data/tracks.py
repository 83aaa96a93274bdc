"""Recorded traffic from which scenes are cut: vehicles by frame, with the agent frames and maps that models need."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from litsim_data.maps.positions import vehicles_of
from litsim_predictor.inference.closed_lines import LENGTH, WIDTH, ClosedLines
from litsim_predictor.inference.contract import HISTORY, HORIZON, STRIDE
from litsim_predictor.inference.features import frame_headings, on_lanes
from litsim_predictor.inference.lane_frames import NO_LANE_FRAMES, LaneFrameFinder, LaneFrames
from litsim_predictor.inference.raster import MapRaster, raster_of_net
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray, is_obstacle
from litsim_sim.scenario.signals import Signals


@dataclass(frozen=True)
class Tracks:
    """Vehicles of one source in R rows, sorted by vehicle and frame; tracks may have gaps.

    Attributes:
        name: name of the source.
        vehicle, frame: (R,) ids of vehicles and numbers of frames.
        motion: (R, 4) box centre x, y [m], yaw [rad], speed [m/s].
        size: (R, 2) length, width [m].
        heading: (R,) headings of the agent frames [rad].
        target: (R,) bool, whether losses and scores may refer to the row; other rows are context only.
        raster: the map as a raster.
        lanes: the lanes of the map, for forecasts along bends; None without a map.
    """

    name: str
    vehicle: IntArray
    frame: IntArray
    motion: FloatArray
    size: FloatArray
    heading: FloatArray
    target: BoolArray
    raster: MapRaster
    lanes: LaneFrameFinder | None = None

    @classmethod
    def from_table(
        cls,
        name: str,
        table: pd.DataFrame,
        net: Path | None,
        target: BoolArray | None = None,
        signals: Signals | None = None,
        begin: int = 0,
    ) -> Tracks:
        """Returns tracks of a `table` with columns vehicle_id, frame, x, y, yaw, speed, length, width (neutral schema).

        Stop lines that `signals`, known from frame `begin` on, close are among the vehicles, but are no targets. All
        rows of `table` are targets if `target` (R,), in its order, is None. Pedestrians and cyclists, if there is a
        column kind, are left out as in runs.

        Raises:
            InputError: `net` is not a readable net, or is too large; or `table` holds no vehicles.
        """
        if "kind" in table:
            target = None if target is None else target[~is_obstacle(table["kind"].to_numpy())]
            table = vehicles_of(table, name)
        lane_map, raster = (None, MapRaster(None)) if net is None else raster_of_net(net)
        if signals is not None:
            lines = _closed_lines(signals, begin, int(table["vehicle_id"].min()) - 1)
            target = np.r_[np.ones(len(table), np.bool_) if target is None else target, np.zeros(len(lines), np.bool_)]
            table = pd.concat([table[lines.columns], lines], ignore_index=True)
        order = np.lexsort([table["frame"], table["vehicle_id"]])
        rows = table.iloc[order]
        motion = rows[["x", "y", "yaw", "speed"]].to_numpy(np.float64)
        return cls(
            name=name,
            vehicle=rows["vehicle_id"].to_numpy(np.int64),
            frame=rows["frame"].to_numpy(np.int64),
            motion=motion,
            size=rows[["length", "width"]].to_numpy(np.float64),
            heading=frame_headings(lane_map, motion[:, 0], motion[:, 1], motion[:, 2]),
            target=np.ones(len(rows), np.bool_) if target is None else target[order],
            raster=raster,
            lanes=None if lane_map is None else LaneFrameFinder(lane_map),
        )

    def __len__(self) -> int:
        return len(self.vehicle)

    def take(self, keep: BoolArray) -> Tracks:
        """Returns the tracks reduced to the rows in the mask `keep` (R,)."""
        by_row = ("vehicle", "frame", "motion", "size", "heading", "target")
        return replace(self, **{name: getattr(self, name)[keep] for name in by_row})

    def without_lines(self) -> Tracks:
        """Returns the tracks of the vehicles alone, for models that do not see closed stop lines."""
        return self.take(~self.is_line) if self.is_line.any() else self

    @cached_property
    def is_line(self) -> BoolArray:
        """(R,) whether rows are those of closed stop lines."""
        return self.size[:, 0] == LENGTH

    def learned_of(self, fraction: float, random: np.random.Generator) -> Tracks:
        """Returns the tracks with a `fraction` of the targets, at least one vehicle; all other rows are context.

        These vehicles have consecutive ids from a `random` one on, as in a shorter recording; after the last comes the
        first.
        """
        ids = np.unique(self.vehicle[self.target])
        learned = np.roll(ids, -int(random.integers(max(1, len(ids)))))[: max(1, round(fraction * len(ids)))]
        return replace(self, target=self.target & np.isin(self.vehicle, learned))

    @cached_property
    def frames(self) -> IntArray:
        """Numbers of the frames with a vehicle, ascending."""
        return np.unique(self.frame)

    @cached_property
    def target_frames(self) -> IntArray:
        """Numbers of the frames with a target, ascending."""
        return np.unique(self.frame[self.target])

    @cached_property
    def learnable(self) -> BoolArray:
        """(R,) mask of the targets of which a model's horizon holds at least one step."""
        rows, learnable = np.flatnonzero(self.target), np.zeros(len(self), np.bool_)
        for step in range(STRIDE, STRIDE * HORIZON + 1, STRIDE):
            learnable[rows] |= self.window(rows, np.array([step]))[1][:, 0]
        return learnable

    @cached_property
    def _by_frame(self) -> tuple[IntArray, IntArray]:
        order = np.argsort(self.frame, kind="stable")
        return order, np.append(np.searchsorted(self.frame[order], self.frames), len(order))

    def rows_at(self, frame: int) -> IntArray:
        """Returns the rows of the vehicles in `frame`, by ascending id; none in a frame without vehicles."""
        order, first = self._by_frame
        index = int(np.searchsorted(self.frames, frame))
        if index == len(self.frames) or self.frames[index] != frame:
            return np.empty(0, np.int64)
        return order[first[index] : first[index + 1]]

    def window(self, rows: IntArray, steps: IntArray) -> tuple[IntArray, BoolArray]:
        """Returns rows (n, m) of the vehicles in `rows` (n,) `steps` (m,) frames later, and a mask of valid ones."""
        key = self._key(self.vehicle[rows][:, None], self.frame[rows][:, None] + steps)
        places = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        return places, self._keys[places] == key

    def history(self, rows: IntArray) -> tuple[IntArray, BoolArray]:
        """Returns the rows (n, HISTORY) at the steps of a model's history, as :meth:`window` gives them."""
        return self.window(rows, STRIDE * np.arange(1 - HISTORY, 1))

    def future(self, rows: IntArray) -> tuple[IntArray, BoolArray]:
        """Returns the rows (n, HORIZON) at the steps of a model's horizon, as :meth:`window` gives them."""
        return self.window(rows, STRIDE * np.arange(1, HORIZON + 1))

    def lane_frames(self, rows: IntArray) -> LaneFrames:
        """Returns the lane frames of those of the vehicles in `rows` whose lanes bend."""
        if self.lanes is None:
            return NO_LANE_FRAMES
        x, y, yaw, speed = self.motion[rows].T
        return self.lanes.ahead(*on_lanes(self.lanes.lane_map, x, y, yaw), speed)

    @cached_property
    def _keys(self) -> IntArray:
        return self._key(self.vehicle, self.frame)

    @cached_property
    def _reach(self) -> tuple[int, int]:
        """First frame that a window may ask for, and number of frames up to the last one."""
        first, last = int(self.frame.min()) - STRIDE * HISTORY, int(self.frame.max()) + STRIDE * HORIZON
        return first, last - first + 1

    def _key(self, vehicle: IntArray, frame: IntArray) -> IntArray:
        low, span = self._reach
        return vehicle * span + (frame - low)


def _closed_lines(signals: Signals, begin: int, number: int) -> pd.DataFrame:
    """Returns closed stop lines as rows of vehicles, with ids from `number` down, in frames from `begin` on.

    `begin` is the first frame of `signals`; see :mod:`litsim_predictor.inference.closed_lines`.
    """
    lines = ClosedLines(signals)
    closed = np.stack([lines.closed(step)[0] for step in range(signals.states.shape[1])])
    step, line = np.nonzero(closed)
    x, y, yaw = lines.pose[line].T
    place = {"vehicle_id": number - line, "frame": begin + step, "x": x, "y": y, "yaw": yaw, "speed": 0.0}
    return pd.DataFrame(place | {"length": LENGTH, "width": WIDTH})
