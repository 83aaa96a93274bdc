"""The net of scenario `urban`: a two-way street of 50 km/h that crosses two side streets at traffic signals.

Left turns have a lane of their own and no phase of their own: they wait inside the junction for a gap in the oncoming
traffic (unprotected). Frame map: x along the main street from west to east, the junctions at x = -100 and x = 100 m.
netconvert is needed only here: ``pip install -r requirements/maps.txt``.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

from litsim_data.maps.netconvert import build_net

JUNCTIONS = {"A": -100.0, "B": 100.0}  # [m] x of the signalised junctions
ARM = 150.0  # [m] from a junction to where the net ends
LANE_WIDTH = 3.3  # [m]
SPEED_LIMIT = 13.89  # [m/s] 50 km/h
CYCLE = {"main": 28, "side": 20, "yellow": 3, "all_red": 2}  # [s]; the two directions follow each other
TURN_ACCELERATION = 2.5  # [m/s2] lateral, of turning vehicles: comfortable
OFFSET = {"A": 0, "B": 24}  # [s] of the signal plans
OPTIONS = ("--junctions.internal-link-detail", "15", "--junctions.limit-turn-speed", f"{TURN_ACCELERATION}")
"""Of netconvert, by which ways through junctions are smooth curves and slow enough for them."""

MAIN_LANES = 3  # of an edge that ends at a junction: right and through, through, left
SIDE_LANES = 2  # right and through, left
EXIT_LANES = {"main": 2, "side": 1}


def plain_xml() -> dict[str, ET.Element]:
    """The plan as SUMO's plain XML, by file name: nodes, edges, connections, signal plans."""
    nodes = ET.Element("nodes")
    ends = {"W": (JUNCTIONS["A"] - ARM, 0.0), "E": (JUNCTIONS["B"] + ARM, 0.0)}
    for name, x in JUNCTIONS.items():
        ET.SubElement(nodes, "node", {"id": name, "x": f"{x}", "y": "0", "type": "traffic_light", "radius": "8"})
        ends |= {f"{name}N": (x, ARM), f"{name}S": (x, -ARM)}
    for name, (x, y) in ends.items():
        ET.SubElement(nodes, "node", {"id": name, "x": f"{x}", "y": f"{y}", "type": "dead_end"})

    edges, connections, signals = ET.Element("edges"), ET.Element("connections"), ET.Element("tlLogics")
    for name in JUNCTIONS:
        arms = arms_of(name)
        for arm in arms:
            main = arm in ("W", "E", *JUNCTIONS)
            _edge(edges, arm, name, MAIN_LANES if main else SIDE_LANES)
            if arm not in JUNCTIONS:  # otherwise it is the other junction's approach
                _edge(edges, name, arm, EXIT_LANES["main" if main else "side"])
        _connect(connections, signals, name, arms)
    return {"road.nod.xml": nodes, "road.edg.xml": edges, "road.con.xml": connections, "road.tll.xml": signals}


def arms_of(junction: str) -> tuple[str, str, str, str]:
    """Names of the nodes around `junction`: west, north, east, south of it."""
    west, east = ("W", "B") if junction == "A" else ("A", "E")
    return west, f"{junction}N", east, f"{junction}S"


def write_net(path: Path) -> None:
    """Build the net at `path`.

    Raises:
        InputError: netconvert is not installed or refuses the plan, or `path` cannot be written.
    """
    build_net(plain_xml(), path, OPTIONS)


def _edge(edges: ET.Element, start: str, end: str, lanes: int) -> None:
    attributes = {"id": f"{start}{end}", "from": start, "to": end, "numLanes": str(lanes)}
    attributes |= {"width": f"{LANE_WIDTH}", "speed": f"{SPEED_LIMIT}"}
    ET.SubElement(edges, "edge", {**attributes, "priority": "2" if lanes > SIDE_LANES else "1"})


def _connect(connections: ET.Element, signals: ET.Element, name: str, arms: tuple[str, str, str, str]) -> None:
    """Movements of a junction and its signal plan, one signal a movement, numbered in the order written."""
    greens = {"main": "", "side": ""}  # states of all signals while that street has green
    places: list[dict[str, str]] = []
    for at, arm in enumerate(arms):
        street = "side" if at % 2 else "main"
        through, left, right = (arms[(at + turn) % 4] for turn in (2, 1, 3))
        lanes = SIDE_LANES if at % 2 else MAIN_LANES
        movements = [(right, 0, 0), *((through, lane, lane) for lane in range(lanes - 1))]
        movements.append((left, lanes - 1, 0 if street == "main" else 1))  # into the left of the through lanes
        for target, from_lane, to_lane in movements:
            attributes = {"from": f"{arm}{name}", "to": f"{name}{target}", "tl": name}
            lane = {"fromLane": str(from_lane), "toLane": str(to_lane), "linkIndex": str(len(greens["main"]))}
            ET.SubElement(connections, "connection", attributes | lane)
            places.append(attributes | lane)
            # G goes first; g may go, and gives way
            go = "g" if target == left else "G"
            for other in greens:
                greens[other] += go if other == street else "r"
    logic = ET.SubElement(
        signals, "tlLogic", {"id": name, "type": "static", "programID": "0", "offset": str(OFFSET[name])}
    )
    for street, state in greens.items():
        yellow, red = re.sub("[Gg]", "y", state), "r" * len(state)
        for duration, signal in ((CYCLE[street], state), (CYCLE["yellow"], yellow), (CYCLE["all_red"], red)):
            ET.SubElement(logic, "phase", {"duration": str(duration), "state": signal})
    for place in places:  # netconvert numbers links anew, unless they are numbered beside the plan
        ET.SubElement(signals, "connection", place)
