"""Nets of one motorway carriageway: through lanes, an auxiliary lane, an on-ramp and an off-ramp.

The layouts are those of NGSIM's sites as their published descriptions give them. Packaged under ``nets/``:
``us101_like``, straight and of round numbers; and ``us101``, fitted to real tracks by :mod:`litsim_data.maps.fitting`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.maps.netconvert import DECIMALS, WITHOUT_INTERNAL_LANES, build_net, shape_text
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray

LANE_WIDTH = 3.66  # [m] 12 ft
SPEED_LIMIT = 29.0  # [m/s] 65 mph
RAMP_SPEED_LIMIT = 22.0  # [m/s] 50 mph
VERTEX_SPACING = 10.0  # [m] of the written shapes: the chord error is below 1 cm at the sites' curvature
MARGIN = 120.0  # [m] of road before and after the recorded stretch


@dataclass(frozen=True)
class Ramp:
    """A straight ramp lane that runs beside the road for VERTEX_SPACING at its gore, then leaves it at an angle.

    Attributes:
        gore: distance along the road's left edge at which ramp and auxiliary lane meet [m].
        taper: metres that the ramp moves sideways per metre along the road.
        length: how far from the gore the ramp reaches, along the road [m].
    """

    gore: float
    taper: float = 0.06
    length: float = 150.0


@dataclass(frozen=True)
class HighwayPlan:
    """A carriageway's geometry in frame map.

    Attributes:
        left_edge: (k, 2) left edge of the leftmost lane in driving direction [m].
        on_ramp, off_ramp: the auxiliary lane lies between their gores; without an off-ramp it ends at
            `auxiliary_end`, without an on-ramp there is neither ramp nor auxiliary lane.
        widths: width of each through lane, leftmost first [m]; auxiliary lane and ramps have LANE_WIDTH.
        auxiliary_end: along the left edge, where the auxiliary lane ends if there is no off-ramp [m].
    """

    left_edge: FloatArray
    on_ramp: Ramp | None = None
    off_ramp: Ramp | None = None
    widths: tuple[float, ...] = (LANE_WIDTH,) * 5
    auxiliary_end: float | None = None

    @property
    def lanes(self) -> int:
        """Number of through lanes."""
        return len(self.widths)


def write_net(plan: HighwayPlan, path: Path) -> None:
    """Builds the SUMO net of `plan` at `path`.

    Raises:
        InputError: netconvert is not installed or refuses the plan, or `path` cannot be written.
    """
    build_net(plain_xml(plan), path, WITHOUT_INTERNAL_LANES)


def plain_xml(plan: HighwayPlan) -> dict[str, ET.Element]:
    """Returns the plan as SUMO's plain XML: nodes, edges and connections, by what they are.

    Raises:
        InputError: the gores lie off the road or in the wrong order.
    """
    shapes = _edge_shapes(plan)
    between = {
        "upstream": ("begin", "merge"),
        "weave": ("merge", "diverge"),
        "downstream": ("diverge", "end"),
        "on_ramp": ("on", "merge"),
        "off_ramp": ("diverge", "off"),
        "road": ("begin", "end"),
    }
    nodes, edges = ET.Element("nodes"), ET.Element("edges")
    places: dict[str, FloatArray] = {}
    for name in shapes:  # ramps come last: where they meet the road, the road says where
        for node, point in zip(between[name], shapes[name][[0, -1]], strict=True):
            places.setdefault(node, point)
    for name, (x, y) in places.items():
        # Radius 0 keeps netconvert from cutting the lanes back at a junction, so that they follow without a gap.
        inner = {"type": "priority", "radius": "0"}
        kind = inner if name in ("merge", "diverge") else {"type": "dead_end"}
        ET.SubElement(nodes, "node", {"id": name, "x": _number(x), "y": _number(y), **kind})
    for name, shape in shapes.items():
        edges.append(_edge(plan, name, between[name], shape))

    connections = ET.Element("connections")
    for start, from_lane, end, to_lane in _links(plan, shapes):
        attributes = {"from": start, "to": end, "fromLane": str(from_lane), "toLane": str(to_lane)}
        ET.SubElement(connections, "connection", attributes)
    return {"node": nodes, "edge": edges, "connection": connections}


def _edge(plan: HighwayPlan, name: str, ends: tuple[str, str], shape: FloatArray) -> ET.Element:
    ramp = "ramp" in name
    widths = () if ramp else plan.widths + (LANE_WIDTH,) * (name == "weave")
    attributes = {"id": name, "from": ends[0], "to": ends[1], "numLanes": str(max(len(widths), 1))}
    attributes |= {"speed": str(RAMP_SPEED_LIMIT if ramp else SPEED_LIMIT), "priority": "1" if ramp else "3"}
    attributes |= {"width": _number(LANE_WIDTH), "spreadType": "right", "shape": shape_text(shape)}
    edge = ET.Element("edge", attributes)
    for index, width in enumerate(reversed(widths)):
        ET.SubElement(edge, "lane", {"index": str(index), "width": _number(width)})
    return edge


def _links(plan: HighwayPlan, shapes: dict[str, FloatArray]) -> list[tuple[str, int, str, int]]:
    """Returns the links, from edge and lane to edge and lane; lanes count from the right."""
    if "weave" not in shapes:
        return []
    links = [("on_ramp", 0, "weave", 0)]
    links += [("weave", 0, "off_ramp", 0)] if "off_ramp" in shapes else []
    for lane in range(plan.lanes):
        links += [("upstream", lane, "weave", lane + 1), ("weave", lane + 1, "downstream", lane)]
    return links


def _number(value: float) -> str:
    return f"{value:.{DECIMALS}f}"


def _edge_shapes(plan: HighwayPlan) -> dict[str, FloatArray]:
    """Returns the left edge (k, 2) [m] of every SUMO edge, by its name."""
    edge = plan.left_edge
    steps = np.hypot(*np.diff(edge, axis=0).T)
    s = np.concatenate([[0.0], np.cumsum(steps)])
    total = float(s[-1])

    def stretch(start: float, end: float) -> FloatArray:
        at = np.concatenate([[start], s[(s > start + 1.0) & (s < end - 1.0)], [end]])
        return np.column_stack([np.interp(at, s, edge[:, 0]), np.interp(at, s, edge[:, 1])])

    def ramp_edge(ramp: Ramp, direction: float) -> FloatArray:
        away = np.arange(0.0, ramp.length + VERTEX_SPACING / 2, VERTEX_SPACING)
        lateral = sum(plan.widths) + ramp.taper * np.maximum(away - VERTEX_SPACING, 0.0)
        points = _offset_to_right(edge, s, ramp.gore + direction * away, lateral)
        return points if direction > 0 else points[::-1]

    end = plan.off_ramp.gore if plan.off_ramp is not None else plan.auxiliary_end
    if plan.on_ramp is None or end is None:
        return {"road": stretch(0.0, total)}
    on = plan.on_ramp.gore
    if not 0.0 < on < end < total:
        raise InputError(f"the gores must lie along the road in order: 0 < {on} < {end} < {total:.1f} m")
    shapes = {
        "upstream": stretch(0.0, on),
        "weave": stretch(on, end),
        "downstream": stretch(end, total),
        "on_ramp": ramp_edge(plan.on_ramp, -1.0),
    }
    return shapes if plan.off_ramp is None else {**shapes, "off_ramp": ramp_edge(plan.off_ramp, 1.0)}


def _offset_to_right(line: FloatArray, s_line: FloatArray, s: FloatArray, lateral: FloatArray) -> FloatArray:
    """Returns points (m, 2) at arc lengths `s` (m,) of `line`, `lateral` (m,) metres to its right."""
    reach = 1.0  # [m] over which the tangent is taken, so that a vertex has the mean of its two segments
    ahead, behind = np.minimum(s + reach, s_line[-1]), np.maximum(s - reach, 0.0)

    def at(where: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(where, s_line, line[:, 0]), np.interp(where, s_line, line[:, 1])])

    tangent = at(ahead) - at(behind)
    tangent /= np.hypot(tangent[:, 0], tangent[:, 1])[:, None]
    right = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    return at(s) + lateral[:, None] * right
