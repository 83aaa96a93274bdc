"""Checks of a net against the recording that lies on it, and against published centre lines.

Measures, each a function of its own; :func:`check_net` runs them all:

- how many vehicle centres lie within half a lane width of a lane's centre line: of the lane that they are on, and of
  the lane that the recording names;
- how many are on the lane that the recording names;
- how far lane centre lines lie from CAD centre lines over the recorded stretch;
- whether every lane on which vehicles come in leads out of the net;
- whether SUMO loads the net without a warning.
"""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.maps.cad import CenterLine, distance_to_lines
from litsim_sim.maps.lane_map import LaneMap
from litsim_sim.maps.net_lanes import Lane

SAMPLE = 2.0  # [m] between the points of a centre line that are compared
COVERED = 20.0  # [m] side of the cells in which a vehicle makes the road count as recorded
INSIDE_GOAL = 0.99
CAD_GOAL = 0.3  # [m]
_LOAD = "import libsumo, sys; libsumo.start(['sumo', '-n', sys.argv[1], '--no-step-log']); libsumo.close()"


@dataclass(frozen=True)
class Placement:
    """How vehicle centres lie on the lanes; shares of `rows`.

    Attributes:
        rows: number of rows.
        inside: within half a lane width of the centre line of the lane that they are on.
        inside_named: within half a lane width of the centre line of the lane that the recording names.
        agreement: on the lane that the recording names; these two are NaN where it names none.
        named: rows with a lane number, the base of the latter two.
        offset: median distance to the left of the lane's middle [m].
    """

    rows: int
    inside: float
    inside_named: float
    agreement: float
    named: int
    offset: float


@dataclass(frozen=True)
class CadDistance:
    """Distance of lane centre lines to CAD centre lines over the recorded stretch.

    Attributes:
        median, p95: over all samples [m].
        by_line: median by CAD line [m].
        samples: number of points compared.
    """

    median: float
    p95: float
    by_line: dict[str, float]
    samples: int


@dataclass(frozen=True)
class NetCheck:
    """Everything that was checked; `placements` by the name of the part of the recording.

    Attributes:
        stuck: lanes on which vehicles come in and from which no exit is reached.
        ending: lanes that end before the net does, so that one must change lanes.
        warnings: what SUMO says on loading.
    """

    lanes: int
    placements: dict[str, Placement] = field(default_factory=dict)
    cad: CadDistance | None = None
    stuck: tuple[str, ...] = ()
    ending: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def failures(self) -> list[str]:
        """A sentence for every goal that is missed; empty where all are met."""
        missed = [
            f"{name}: {part.inside:.2%} of the vehicle centres lie on a lane, goal {INSIDE_GOAL:.0%}"
            for name, part in self.placements.items()
            if part.inside < INSIDE_GOAL
        ]
        if self.cad is not None and not self.cad.median < CAD_GOAL:
            missed.append(f"the median distance to the CAD centre lines is {self.cad.median:.2f} m, goal {CAD_GOAL} m")
        missed += [f"lane {lane} leads to no exit" for lane in self.stuck]
        return missed + [f"SUMO: {warning}" for warning in self.warnings]

    def text(self) -> str:
        """The result as lines of text: a table of placements, and what else was found."""
        lines = [f"{'part':<28}{'rows':>8}{'on a lane':>11}{'on named':>10}{'label ok':>10}{'offset m':>10}"]
        for name, part in self.placements.items():
            named = f"{part.inside_named:>10.2%}{part.agreement:>10.2%}" if part.named else f"{'-':>10}{'-':>10}"
            lines.append(f"{name:<28}{part.rows:>8}{part.inside:>11.2%}{named}{part.offset:>10.2f}")
        if self.cad is not None:
            each = ", ".join(f"{name} {value:.2f}" for name, value in sorted(self.cad.by_line.items()))
            lines.append(f"CAD: median {self.cad.median:.3f} m, 95th percentile {self.cad.p95:.3f} m ({each})")
        ends = f"; ending early: {', '.join(self.ending)}" if self.ending else ""
        lines.append(f"lanes: {self.lanes}, without exit: {', '.join(self.stuck) or 'none'}{ends}")
        lines.append(f"SUMO: {'; '.join(self.warnings) or 'loads without warnings'}")
        lines += [f"MISSED: {missed}" for missed in self.failures]
        return "\n".join(lines)


def check_net(net: Path, parts: dict[str, pd.DataFrame], cad: list[CenterLine] | None = None) -> NetCheck:
    """Check the net at `net`.

    Args:
        net: SUMO net.
        parts: neutral tables (columns x, y, yaw, lane are used) by name.
        cad: centre lines in frame map.

    Raises:
        InputError: the net cannot be read, or `cad` lies nowhere near it.
    """
    lane_map = LaneMap.from_net(net)
    stuck, ending = connectivity(lane_map)
    everything = pd.concat(list(parts.values())) if parts else pd.DataFrame({"x": [], "y": []})
    return NetCheck(
        lanes=len(lane_map.lanes),
        placements={name: placement(lane_map, table) for name, table in parts.items()},
        cad=None if cad is None else cad_distance(lane_map, everything, cad),
        stuck=stuck,
        ending=ending,
        warnings=load_warnings(net),
    )


def placement(lane_map: LaneMap, table: pd.DataFrame) -> Placement:
    """How the vehicle centres of a neutral `table` lie on the lanes."""
    x, y, yaw = (table[name].to_numpy(np.float64) for name in ("x", "y", "yaw"))
    label = table["lane"].to_numpy(np.int64)
    at = lane_map.nearest(x, y, yaw)
    numbers = lane_numbers(lane_map)
    named = (label >= 1) & (numbers[at.lane] >= 1)
    inside_named = np.zeros(len(x), np.bool_)
    for number in np.unique(label[named]):
        mine = label == number
        rows = np.flatnonzero(numbers == number)
        if len(rows):
            lanes = LaneMap([replace(lane_map.lanes[row], successors=()) for row in rows])
            inside_named[mine] = lanes.inside_road(x[mine], y[mine])
    count = int(named.sum())
    return Placement(
        rows=len(x),
        inside=float(lane_map.inside_road(x, y).mean()),
        inside_named=float(inside_named[named].mean()) if count else float("nan"),
        agreement=float((numbers[at.lane] == label)[named].mean()) if count else float("nan"),
        named=count,
        offset=float(np.median(at.d)),
    )


def lane_numbers(lane_map: LaneMap) -> IntArray:
    """(lanes,) numbers from 1 at the left edge of the road; 0 inside junctions.

    A ramp (an edge of one lane that runs into or comes out of one lane of several) goes on with the number of that
    lane.
    """
    count: dict[str, int] = {}
    for lane in lane_map.lanes:
        count[lane.edge_id] = max(count.get(lane.edge_id, 0), lane.index + 1)

    def number(lane: Lane) -> int:
        return 0 if lane.is_internal else count[lane.edge_id] - lane.index

    numbers = [number(lane) for lane in lane_map.lanes]
    for row, lane in enumerate(lane_map.lanes):
        for name in lane.successors:
            after = lane_map.row(name)
            if lane.is_internal or lane_map.lanes[after].is_internal:
                continue
            if count[lane.edge_id] == 1:
                numbers[row] = max(numbers[row], number(lane_map.lanes[after]))
            if count[lane_map.lanes[after].edge_id] == 1:
                numbers[after] = max(numbers[after], numbers[row])
    return np.array(numbers, np.int64)


def cad_distance(lane_map: LaneMap, table: pd.DataFrame, cad: list[CenterLine]) -> CadDistance:
    """Distance of the lanes to the CAD centre lines; ramps and junctions do not count.

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
    by_number = {int(found[0]): line for line in cad if (found := re.findall(r"\d+$", line.name))}
    others = [line for line in cad if line not in by_number.values()]
    found_by_line: dict[str, list[FloatArray]] = {}
    for row, (lane, number) in enumerate(zip(lane_map.lanes, lane_numbers(lane_map).tolist(), strict=True)):
        against = [by_number[number]] if number in by_number else others
        if lane.is_internal or counts[lane.edge_id] == 1 or not against:
            continue
        x, y, _ = lane_map.pose_at(row, np.arange(0.0, lane.length, SAMPLE))
        cells = zip(np.floor(x / COVERED).astype(int), np.floor(y / COVERED).astype(int), strict=True)
        keep = np.array([not recorded or cell in recorded for cell in cells], np.bool_)
        distance, which, within = distance_to_lines(np.column_stack([x, y])[keep], against)
        for i, line in enumerate(against):
            found_by_line.setdefault(line.name, []).append(distance[within & (which == i)])
    joined = {name: np.concatenate(parts) for name, parts in found_by_line.items()}
    joined = {name: values for name, values in joined.items() if len(values)}
    if not joined:
        raise InputError("the CAD centre lines lie nowhere beside the recorded lanes: is it the right site?")
    every = np.concatenate(list(joined.values()))
    by_line = {name: float(np.median(values)) for name, values in joined.items()}
    return CadDistance(float(np.median(every)), float(np.quantile(every, 0.95)), by_line, len(every))


def connectivity(lane_map: LaneMap) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Lanes without a way out, and lanes that end early.

    Returns:
        Ids of lanes on which vehicles come in (nothing leads to them) and from which no exit is reached by following
        the lanes, where one changes lanes only off a lane that ends early; and ids of the lanes that do so: that lead
        nowhere while their edge goes on.
    """
    lanes = lane_map.lanes
    onwards = {lane.edge_id for lane in lanes if lane.successors}
    ending = tuple(lane.id for lane in lanes if not lane.successors and lane.edge_id in onwards)
    exits = {lane.id for lane in lanes if lane.edge_id not in onwards}
    entered = {name for lane in lanes for name in lane.successors}
    # Backwards from the exits; from a lane that ends early one changes to a neighbour.
    leads_out = set(exits)
    while True:
        more = {
            lane.id
            for lane in lanes
            if lane.id not in leads_out
            and (
                any(name in leads_out for name in lane.successors)
                or (lane.id in ending and not {lane.left, lane.right}.isdisjoint(leads_out))
            )
        }
        if not more:
            break
        leads_out |= more
    return tuple(lane.id for lane in lanes if lane.id not in entered and lane.id not in leads_out), ending


def load_warnings(net: Path) -> tuple[str, ...]:
    """What SUMO says when it loads the net, in a process of its own (libsumo is one per process)."""
    done = subprocess.run([sys.executable, "-c", _LOAD, str(net)], capture_output=True, text=True, check=False)
    said = [line.strip() for line in (done.stdout + done.stderr).splitlines()]
    said = [line for line in said if line.startswith(("Warning", "Error"))]
    if done.returncode != 0 and not said:
        said = [f"SUMO ended with status {done.returncode}"]
    return tuple(said)
