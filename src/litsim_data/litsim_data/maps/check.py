"""Checks of a net against the recording that lies on it.

:func:`check_net` runs them all: how vehicle centres lie on the lanes, and on those that the recording names
(:mod:`.placement`); by which shift and turn they would lie best (:mod:`.alignment`); where lanes lead, which have no
way in or out, and which cross (:mod:`.connectivity`); which connections conflict and have green together
(:mod:`.green_conflicts`); and whether SUMO loads the net without a warning.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from litsim_data.maps.alignment import Alignment, align
from litsim_data.maps.connectivity import Connectivity, connectivity
from litsim_data.maps.placement import Placement, placement
from litsim_sim.lane_map.green_conflicts import program_conflicts
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.sumo_loading import begin_loading

INSIDE_GOAL = 0.99


@dataclass(frozen=True)
class NetCheck:
    """Everything that was checked; `placements` and `alignments` by the name of the part of the recording.

    Attributes:
        lanes: number of lanes.
        placements: how positions lie on the lanes.
        alignments: how they would lie best.
        connectivity: where lanes lead, and where they do not.
        greens: see :func:`.green_conflicts.program_conflicts`.
        warnings: what SUMO says on loading.
    """

    lanes: int
    placements: dict[str, Placement] = field(default_factory=dict)
    alignments: dict[str, Alignment] = field(default_factory=dict)
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
        return [*missed, *self.connectivity.failures, *self.greens, *(f"SUMO: {warning}" for warning in self.warnings)]


def check_net(net: Path, parts: dict[str, pd.DataFrame]) -> NetCheck:
    """Checks the net at `net`.

    Args:
        net: SUMO net.
        parts: neutral tables (columns vehicle_id, frame, x, y, yaw, lane are used) by name, with at least a row each.

    Raises:
        InputError: the net cannot be read.
    """
    lane_map = LaneMap.from_net(net)
    return NetCheck(
        lanes=len(lane_map.lanes),
        placements={name: placement(lane_map, table) for name, table in parts.items()},
        alignments={name: align(lane_map, table) for name, table in parts.items()},
        connectivity=connectivity(lane_map),
        greens=program_conflicts(net),
        warnings=load_warnings(net),
    )


def load_warnings(net: Path) -> tuple[str, ...]:
    """Returns what SUMO says when it loads the net."""
    process = begin_loading(net)
    lines = [line.strip() for text in process.communicate() for line in text.splitlines()]
    told = [line for line in lines if line.startswith(("Warning", "Error"))]
    if process.returncode != 0 and not told:
        told = [f"SUMO ended with status {process.returncode}: {next(filter(None, reversed(lines)), 'without a word')}"]
    return tuple(told)
