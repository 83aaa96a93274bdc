"""Nets of one motorway section with an auxiliary lane between an on-ramp and an off-ramp, written for netconvert.

The layout is that of NGSIM's US-101 site as its published description gives it (five lanes, an auxiliary lane from the
on-ramp at 579 ft to the off-ramp 698 ft further on). Two nets of this layout are packaged under ``nets/``:
``us101_like``, straight and of round numbers, and ``us101``, fitted to real tracks by :mod:`litsim_sim.maps.fitting`.
netconvert is needed only here, never to run a simulation: ``pip install -r requirements/maps.txt``.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from litsim_sim.errors import InputError
from litsim_sim.scene import FloatArray

LANE_WIDTH = 3.66  # [m] 12 ft
SPEED_LIMIT = 29.0  # [m/s] 65 mph
RAMP_SPEED_LIMIT = 22.0  # [m/s] 50 mph
VERTEX_SPACING = 10.0  # [m] of the written shapes: the chord error is below 1 cm at the site's curvature
DECIMALS = 3  # of written coordinates: millimetres


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
    """The section's geometry in frame map.

    Attributes:
        left_edge: (k, 2) left edge of the leftmost lane in driving direction [m].
        on_ramp, off_ramp: the ramps; the auxiliary lane lies between their gores.
        lanes: through lanes.
        lane_width: [m].
    """

    left_edge: FloatArray
    on_ramp: Ramp
    off_ramp: Ramp
    lanes: int = 5
    lane_width: float = LANE_WIDTH


def us101_like_plan() -> HighwayPlan:
    """A straight section of 640 m with the site's layout: x runs along the road from 0, the left edge is y = 0."""
    return HighwayPlan(np.array([[0.0, 0.0], [640.0, 0.0]]), Ramp(gore=176.0), Ramp(gore=389.0))


def write_net(plan: HighwayPlan, path: Path) -> None:
    """Build the SUMO net of `plan` at `path`.

    Raises:
        InputError: netconvert is not installed or refuses the plan.
    """
    program = find_netconvert()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, tree in plain_xml(plan).items():
            ET.indent(tree)
            ET.ElementTree(tree).write(folder / name, encoding="UTF-8", xml_declaration=True)
        command = [
            str(program),
            *("--node-files", "road.nod.xml", "--edge-files", "road.edg.xml", "--connection-files", "road.con.xml"),
            *("--output-file", "road.net.xml", "--precision", str(DECIMALS)),
            # The map frame must stay as planned, and lanes must follow each other without internal lanes between.
            *("--offset.disable-normalization", "--no-internal-links", "--no-turnarounds"),
        ]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0 or not (folder / "road.net.xml").is_file():
            raise InputError(f"netconvert refused the plan of {path.name}: {(done.stderr or done.stdout).strip()}")
        net = (folder / "road.net.xml").read_text(encoding="UTF-8")
    # netconvert heads the file with the date and its command line, which would make every regeneration differ.
    net = re.sub(r"<!--.*?-->\n*", "", net, count=1, flags=re.DOTALL)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(net, encoding="UTF-8")


def find_netconvert() -> Path:
    """The netconvert program: beside this Python, inside the ``eclipse-sumo`` package, or on the PATH.

    Raises:
        InputError: it is in none of these places.
    """
    candidates = [Path(sys.executable).parent / "netconvert"]
    package = find_spec("sumo")
    if package is not None and package.origin:
        candidates.append(Path(package.origin).parent / "bin" / "netconvert")
    on_path = shutil.which("netconvert")
    candidates += [Path(on_path)] if on_path else []
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise InputError("netconvert is not installed; it is needed to build nets: pip install -r requirements/maps.txt")


def plain_xml(plan: HighwayPlan) -> dict[str, ET.Element]:
    """The plan as SUMO's plain XML, by file name: nodes, edges, connections."""
    edges = _edge_shapes(plan)
    ends = {
        "begin": edges["upstream"][0],
        "merge": edges["weave"][0],
        "diverge": edges["downstream"][0],
        "end": edges["downstream"][-1],
        "on": edges["on_ramp"][0],
        "off": edges["off_ramp"][-1],
    }
    nodes = ET.Element("nodes")
    for name, (x, y) in ends.items():
        inner = name in ("merge", "diverge")
        # Radius 0 keeps netconvert from cutting the lanes back at a junction, so that they follow without a gap.
        kind = {"type": "priority", "radius": "0"} if inner else {"type": "dead_end"}
        ET.SubElement(nodes, "node", {"id": name, "x": _number(x), "y": _number(y), **kind})

    between = {
        "upstream": ("begin", "merge", plan.lanes),
        "weave": ("merge", "diverge", plan.lanes + 1),
        "downstream": ("diverge", "end", plan.lanes),
        "on_ramp": ("on", "merge", 1),
        "off_ramp": ("diverge", "off", 1),
    }
    edge_list = ET.Element("edges")
    for name, (start, end, lanes) in between.items():
        ramp = lanes == 1
        attributes = {
            "id": name,
            "from": start,
            "to": end,
            "numLanes": str(lanes),
            "width": f"{plan.lane_width:.{DECIMALS}f}",
            "speed": str(RAMP_SPEED_LIMIT if ramp else SPEED_LIMIT),
            "priority": "1" if ramp else "3",
            "spreadType": "right",
            "shape": " ".join(f"{_number(x)},{_number(y)}" for x, y in edges[name]),
        }
        ET.SubElement(edge_list, "edge", attributes)

    connections = ET.Element("connections")
    links = [("on_ramp", 0, "weave", 0), ("weave", 0, "off_ramp", 0)]
    for lane in range(plan.lanes):
        links += [("upstream", lane, "weave", lane + 1), ("weave", lane + 1, "downstream", lane)]
    for start, from_lane, end, to_lane in links:
        attributes = {"from": start, "to": end, "fromLane": str(from_lane), "toLane": str(to_lane)}
        ET.SubElement(connections, "connection", attributes)
    return {"road.nod.xml": nodes, "road.edg.xml": edge_list, "road.con.xml": connections}


def _number(value: float) -> str:
    return f"{value:.{DECIMALS}f}"


def _edge_shapes(plan: HighwayPlan) -> dict[str, FloatArray]:
    """Left edge (k, 2) of every SUMO edge [m]."""
    edge = plan.left_edge
    steps = np.hypot(*np.diff(edge, axis=0).T)
    s = np.concatenate([[0.0], np.cumsum(steps)])
    on, off, total = plan.on_ramp.gore, plan.off_ramp.gore, float(s[-1])
    if not 0.0 < on < off < total:
        raise InputError(f"the gores must lie along the road in order: 0 < {on} < {off} < {total:.1f} m")

    def stretch(start: float, end: float) -> FloatArray:
        at = np.concatenate([[start], s[(s > start + 1.0) & (s < end - 1.0)], [end]])
        return np.column_stack([np.interp(at, s, edge[:, 0]), np.interp(at, s, edge[:, 1])])

    def ramp_edge(ramp: Ramp, direction: float) -> FloatArray:
        away = np.arange(0.0, ramp.length + VERTEX_SPACING / 2, VERTEX_SPACING)
        lateral = plan.lanes * plan.lane_width + ramp.taper * np.maximum(away - VERTEX_SPACING, 0.0)
        points = _offset_to_right(edge, s, ramp.gore + direction * away, lateral)
        return points if direction > 0 else points[::-1]

    return {
        "upstream": stretch(0.0, on),
        "weave": stretch(on, off),
        "downstream": stretch(off, total),
        "on_ramp": ramp_edge(plan.on_ramp, -1.0),
        "off_ramp": ramp_edge(plan.off_ramp, 1.0),
    }


def _offset_to_right(line: FloatArray, s_line: FloatArray, s: FloatArray, lateral: FloatArray) -> FloatArray:
    """Points (m, 2) at arc lengths `s` (m,) of `line`, `lateral` (m,) metres to its right."""
    reach = 1.0  # [m] over which the tangent is taken, so that a vertex has the mean of its two segments
    ahead, behind = np.minimum(s + reach, s_line[-1]), np.maximum(s - reach, 0.0)

    def at(where: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(where, s_line, line[:, 0]), np.interp(where, s_line, line[:, 1])])

    tangent = at(ahead) - at(behind)
    tangent /= np.hypot(tangent[:, 0], tangent[:, 1])[:, None]
    right = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    return at(s) + lateral[:, None] * right
