"""Checks of a net against the recording that lies on it, and against published centre lines.

:func:`check_net` runs them all: how vehicle centres lie on the lanes, and on those that the recording names
(:mod:`.placement`); by which shift and turn they would lie best (:mod:`.alignment`); where lanes lead, which have no
way in or out, and which cross (:mod:`.connectivity`); which connections conflict and have green together
(:mod:`.green_conflicts`); how far centre lines lie from CAD centre lines over the recorded stretch; and whether SUMO
loads the net without a warning.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from litsim_data.maps.alignment import Alignment, align
from litsim_data.maps.cad import CenterLine, distance_to_lines
from litsim_data.maps.connectivity import Connectivity, connectivity
from litsim_data.maps.placement import Placement, lane_numbers, placement
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.green_conflicts import program_conflicts
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.sumo_loading import begin_loading

SAMPLE = 2.0  # [m] between the points of a centre line that are compared
COVERED = 20.0  # [m] side of the cells in which a vehicle makes the road count as recorded
INSIDE_GOAL = 0.99
CAD_GOAL = 0.3  # [m]


@dataclass(frozen=True)
class CadDistance:
    """Distance of lane centre lines to CAD centre lines over the recorded stretch.

    Attributes:
        median, p95: over all samples [m].
        by_line: median by CAD line [m].
    """

    median: float
    p95: float
    by_line: dict[str, float]


@dataclass(frozen=True)
class NetCheck:
    """Everything that was checked; `placements` and `alignments` by the name of the part of the recording.

    Attributes:
        lanes: number of lanes.
        placements: how positions lie on the lanes.
        alignments: how they would lie best.
        cad: distance to CAD centre lines, where such were given.
        connectivity: where lanes lead, and where they do not.
        greens: see :func:`.green_conflicts.program_conflicts`.
        warnings: what SUMO says on loading.
    """

    lanes: int
    placements: dict[str, Placement] = field(default_factory=dict)
    alignments: dict[str, Alignment] = field(default_factory=dict)
    cad: CadDistance | None = None
    connectivity: Connectivity = field(default_factory=Connectivity)
    greens: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def failures(self) -> list[str]:
        """A sentence for every goal that is missed; empty where all are met."""
        missed = [
            f"{name}: {part.inside:.2%} of the vehicle centres lie on a lane, goal {INSIDE_GOAL:.0%}"
            for name, part in self.placements.items()
            if part.inside < INSIDE_GOAL
        ]
        missed += [
            f"{name}: {part.against:.2%} of the vehicle centres lie on lanes that lead the other way, goal at most "
            f"{1.0 - INSIDE_GOAL:.0%}"
            for name, part in self.placements.items()
            if part.against > 1.0 - INSIDE_GOAL
        ]
        if self.cad is not None and not self.cad.median < CAD_GOAL:
            missed.append(f"the median distance to the CAD centre lines is {self.cad.median:.2f} m, goal {CAD_GOAL} m")
        return [*missed, *self.connectivity.failures, *self.greens, *(f"SUMO: {warning}" for warning in self.warnings)]


def check_net(net: Path, parts: dict[str, pd.DataFrame], cad: list[CenterLine] | None = None) -> NetCheck:
    """Checks the net at `net`.

    Args:
        net: SUMO net.
        parts: neutral tables (columns vehicle_id, frame, x, y, yaw, lane are used) by name, with at least a row each.
        cad: centre lines in frame map.

    Raises:
        InputError: the net cannot be read, or `cad` lies nowhere near it.
    """
    lane_map = LaneMap.from_net(net)
    everything = pd.concat(list(parts.values())) if parts else pd.DataFrame({"x": [], "y": []})
    return NetCheck(
        lanes=len(lane_map.lanes),
        placements={name: placement(lane_map, table) for name, table in parts.items()},
        alignments={name: align(lane_map, table) for name, table in parts.items()},
        cad=None if cad is None else cad_distance(lane_map, everything, cad),
        connectivity=connectivity(lane_map),
        greens=program_conflicts(net),
        warnings=load_warnings(net),
    )


def cad_distance(lane_map: LaneMap, table: pd.DataFrame, cad: list[CenterLine]) -> CadDistance:
    """Returns the distance of the lanes to the CAD centre lines; ramps and junctions do not count.

    A line whose name ends in a number is that of the lane with this number; other lanes are compared with the nearest
    of the other lines.

    Args:
        lane_map: the lanes.
        table: only where it has vehicles lanes count; if it is empty, everywhere.
        cad: lines in frame map.

    Raises:
        InputError: no lane that counts lies beside its CAD line.
    """
    recorded = {*zip(*(np.floor(table[axis].to_numpy() / COVERED).astype(int) for axis in ("x", "y")), strict=True)}
    counts: dict[str, int] = {}
    for lane in lane_map.lanes:
        counts[lane.edge_id] = counts.get(lane.edge_id, 0) + 1
    by_number = {int(digits[0]): line for line in cad if (digits := re.findall(r"\d+$", line.name))}
    others = [line for line in cad if line not in by_number.values()]
    distances_by_line: dict[str, list[FloatArray]] = {}
    for row, (lane, number) in enumerate(zip(lane_map.lanes, lane_numbers(lane_map).tolist(), strict=True)):
        against = [by_number[number]] if number in by_number else others
        if lane.is_internal or counts[lane.edge_id] == 1 or not against:
            continue
        x, y, _ = lane_map.pose_at(row, np.arange(0.0, lane.length, SAMPLE))
        cells = zip(np.floor(x / COVERED).astype(int), np.floor(y / COVERED).astype(int), strict=True)
        keep = np.array([not recorded or cell in recorded for cell in cells], np.bool_)
        distance, which, within = distance_to_lines(np.column_stack([x, y])[keep], against)
        for i, line in enumerate(against):
            distances_by_line.setdefault(line.name, []).append(distance[within & (which == i)])
    joined = {name: np.concatenate(parts) for name, parts in distances_by_line.items()}
    joined = {name: values for name, values in joined.items() if len(values)}
    if not joined:
        raise InputError("the CAD centre lines lie nowhere beside the recorded lanes: is it the right site?")
    every = np.concatenate(list(joined.values()))
    by_line = {name: float(np.median(values)) for name, values in joined.items()}
    return CadDistance(float(np.median(every)), float(np.quantile(every, 0.95)), by_line)


def load_warnings(net: Path) -> tuple[str, ...]:
    """Returns what SUMO says when it loads the net."""
    process = begin_loading(net)
    lines = [line.strip() for text in process.communicate() for line in text.splitlines()]
    told = [line for line in lines if line.startswith(("Warning", "Error"))]
    if process.returncode != 0 and not told:
        told = [f"SUMO ended with status {process.returncode}: {next(filter(None, reversed(lines)), 'without a word')}"]
    return tuple(told)
