"""Traffic lights for nets whose map has none, on the connections that groups of signals name.

Lanes and connections stay as they are: only what SUMO calls a connection's traffic light is added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import yaml

from litsim_data.maps.light_proposal import Proposal, propose_lights
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing, write_text
from litsim_sim.io.input_files import read_plain_xml
from litsim_sim.lane_map.signal_links import ARROW, read_links
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recorded_signals import survey
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.signals import members_of

AT_A_LIGHT = {"M": "O", "=": "O", "m": "o", "s": "o", "w": "o", "Z": "o"}
"""SUMO's states of connections whose light is off, by those without one: with priority, and without."""
OFF_S = 90  # [s] length of the only phase, in which lights are off: what they show comes from files of signals


def place_lights(net: Path, groups: Mapping[str, Sequence[str]], out: Path, where: str) -> list[str]:
    """Writes `net` to `out` with a traffic light on every connection that `groups` name, and returns a line for each.

    Connections that have a light keep it.

    Raises:
        InputError: a file cannot be used; a connection is not in the net; or its junction has other lights, whose
            programs would not be theirs. `where` names the groups.
    """
    links = {link.name: link for link in read_links(net, lights=False)}
    wanted = [name for name in members_of(groups, list(links.values()), where) if not links[name].light]
    root = read_plain_xml(net, "SUMO net")
    lit = {light.get("id", "") for light in root.iter("tlLogic")}
    junctions: dict[str, list[ET.Element]] = {}
    for connection in root.iter("connection"):
        begin, end = (f"{connection.get(side)}_{connection.get(side + 'Lane')}" for side in ("from", "to"))
        if (name := f"{begin}{ARROW}{end}") in wanted:
            junctions.setdefault(links[name].junction, []).append(connection)
    if mixed := sorted(lit & set(junctions)):
        raise InputError(f"{where}: junction {mixed[0]} of {net} has lights on other connections, expected none or all")
    first = list(root).index(root.findall("edge")[-1]) + 1
    for junction, connections in sorted(junctions.items()):
        for index, connection in enumerate(connections):
            state = connection.get("state", "M")
            connection.attrib |= {"tl": junction, "linkIndex": str(index), "state": AT_A_LIGHT.get(state, state)}
        logic = ET.Element("tlLogic", id=junction, type="static", programID="0", offset="0")
        ET.SubElement(logic, "phase", duration=str(OFF_S), state="O" * len(connections))
        root.insert(first, logic)
    for element in root.iter("junction"):
        if element.get("id") in junctions:
            element.set("type", "traffic_light")
    ET.indent(root)
    with replacing(out) as new:
        ET.ElementTree(root).write(new, encoding="UTF-8", xml_declaration=True)
    return [f"junction {name}: lights on {len(those)} connections" for name, those in sorted(junctions.items())]


def propose_for(net: Path, recording: Path, out: Path) -> tuple[Proposal, list[str]]:
    """Proposes lights for `net` by how the vehicles of a recording drive, and puts them on it.

    Writes the net to `out`, and beside it the file of signals, NAME_signals.yaml for NAME.net.xml.

    Returns:
        the proposal, and lines on it and on how many vehicles then pass at red.

    Raises:
        InputError: a file cannot be used, or the recording shows no lights.
    """
    driven = Recording.read(recording)
    frames = int(driven.columns["frame"].max()) + 1
    proposal = propose_lights(read_links(net, lights=False), Log.from_recording(driven, 0, frames))
    notes = place_lights(net, proposal.file.groups, out, str(recording))
    notes += [group.line() for group in proposal.groups]
    notes += [f"lane {lane.name}: no light, as {len(lane.passes)} pass, some at any time" for lane in proposal.unsure]
    notes += survey(proposal.file, out, driven, str(recording))
    beside = out.with_name(f"{out.name.removesuffix('.net.xml')}_signals.yaml")
    content = yaml.safe_dump(proposal.file.model_dump(mode="json", exclude_none=True), sort_keys=False)
    head = f"# Proposed by who stops and starts in {recording.name}, to be confirmed.\n"
    write_text(beside, head + content)
    return proposal, [*notes, f"signals    {beside}"]
