"""Running netconvert: plain XML or a map of another format in, a SUMO net out.

Our own code decides where lanes lie and how they connect; netconvert only assembles the net file. It is needed to build
nets, never to run a simulation: ``pip install -r requirements/maps.txt``.
"""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree as ET

from litsim_data.maps.direct_junctions import with_connecting_roads
from litsim_sim.core.errors import InputError, not_installed
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.files import replacing, write_text
from litsim_sim.io.input_files import read_head, read_plain_xml

DECIMALS = 3  # of written coordinates: millimetres
LEFT_HAND = "LHT"
"""Value of the attribute `rule` of roads on which traffic keeps to the left."""
LANE_NUMBERS = {
    "lane": ("id",),
    "predecessor": ("id",),
    "successor": ("id",),
    "laneLink": ("from", "to"),
    "validity": ("fromLane", "toLane"),
}
"""Attributes of OpenDRIVE with numbers of lanes, by the elements that have them."""
OF_SIGNALS = {"signal": ("id", "s", "type", "orientation", "dynamic"), "signalReference": ("id", "s", "orientation")}
"""Attributes of signals and signs without which netconvert refuses a map."""


def shape_text(line: FloatArray) -> str:
    """Returns the points of a line (k, 2) or (k, 3) [m] as SUMO writes shapes."""
    return " ".join(",".join(f"{value:.{DECIMALS}f}" for value in point) for point in line)


def find_netconvert() -> Path:
    """Returns the netconvert program: beside this Python, inside the ``eclipse-sumo`` package, or on the PATH.

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
    raise not_installed("netconvert", "eclipse-sumo")


def build_net(
    plain: Mapping[str, ET.Element], path: Path, options: Sequence[str], outlines: Mapping[str, str]
) -> list[str]:
    """Assembles `plain` to the net at `path`, in the frame of its coordinates.

    Args:
        plain: root elements of SUMO's plain XML by what they hold: node, edge or connection.
        path: file of the net.
        options: options of netconvert.
        outlines: shapes of junctions in SUMO's format by their id, to replace those of netconvert.

    Returns:
        netconvert's warnings.

    Raises:
        InputError: netconvert is not installed or refuses the plan, or `path` cannot be written.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder, files = Path(scratch), []
        for kind, tree in plain.items():
            ET.ElementTree(tree).write(folder / f"{kind}.xml", encoding="UTF-8", xml_declaration=True)
            files += [f"--{kind}-files", f"{kind}.xml"]
        return _convert([*files, *options], path, folder, outlines, f"the plan of {path.name}")


def import_opendrive(source: Path, path: Path, left_hand: bool | None = None) -> list[str]:
    """Converts the OpenDRIVE file `source` to the net at `path`; the frame is that of the file.

    netconvert reads lanes as leading as in right-hand traffic, whatever attribute `rule` of a road says.

    Args:
        source: the file.
        path: the net to write.
        left_hand: whether traffic keeps to the left; None: as the attribute `rule` of most of its roads says. Maps of
            both rules are for :mod:`.opendrive_lanes`.

    Returns:
        Lines on what is not as the file says, and netconvert's warnings.

    Raises:
        InputError: as :func:`build_net`, or `source` is missing or no OpenDRIVE.
    """
    root = read_plain_xml(source, "OpenDRIVE file")
    direct = root.find("junction[@type='direct']") is not None
    try:
        with_connecting_roads(root)
    except ValueError as error:
        raise InputError(f"{source}: {error}") from error
    signals = _without_unreadable_signals(root)
    inside = unruled(root)
    roads = [road for road in root.findall("road") if road not in inside]
    ruled_left = sum(road.get("rule") == LEFT_HAND for road in roads)
    to_left = 2 * ruled_left > len(roads) if left_hand is None else left_hand
    options = ["--opendrive-files", str(source.resolve()), "--opendrive.curve-resolution", "1"]
    with tempfile.TemporaryDirectory() as scratch:
        if to_left:
            _swap_sides(root)
            options += ["--lefthand", "true"]
        if to_left or direct or signals:
            ET.ElementTree(root).write(Path(scratch) / "rewritten.xodr", encoding="UTF-8", xml_declaration=True)
            options[1] = "rewritten.xodr"
        warnings = _convert(options, path, Path(scratch), {}, str(source))
    other = len(roads) - ruled_left if to_left else ruled_left
    sides = ("right", "left") if to_left else ("left", "right")
    notes = [f"{other} of {len(roads)} roads keep to the {sides[0]} by rule, but are read as keeping to the {sides[1]}"]
    return [*notes * bool(other), *signals, *(f"netconvert: {warning}" for warning in warnings)]


def export_opendrive(net: Path, path: Path) -> list[str]:
    """Converts the SUMO net `net` to the OpenDRIVE map at `path`, in the same frame; returns netconvert's warnings.

    Raises:
        InputError: as :func:`build_net`.
    """
    options = ["--sumo-net-file", str(net.resolve()), "--opendrive-output.lefthand-left", "true"]
    with tempfile.TemporaryDirectory() as scratch, replacing(path) as new:
        warnings = _convert(options, new, Path(scratch), {}, str(net), output="--opendrive-output")
        if is_left_hand(net):  # which netconvert does not write down, and OpenDRIVE has since 1.5
            text = new.read_text(encoding="UTF-8").replace('revMinor="4"', 'revMinor="5"', 1)
            new.write_text(text.replace("<road ", f'<road rule="{LEFT_HAND}" '), encoding="UTF-8")
    return warnings


def unruled(root: ET.Element) -> list[ET.Element]:
    """Returns the roads inside junctions that do not say on which side traffic keeps: on that of those they join."""
    return [road for road in root.findall("road") if road.get("junction", "-1") != "-1" and road.get("rule") is None]


def is_left_hand(net: Path) -> bool:
    """Returns whether traffic on the SUMO net keeps to the left."""
    return b'lefthand="true"' in read_head(net, 5000)


def _without_unreadable_signals(root: ET.Element) -> list[str]:
    """Takes signals and signs that netconvert cannot read out of an OpenDRIVE map; returns a line on each."""
    notes, gone = [], set()
    for road in root.findall("road"):
        for group in road.findall("signals"):
            for signal in list(group):
                values = {name: (signal.get(name) or "").strip() for name in OF_SIGNALS.get(signal.tag, ())}
                lacking = [name for name, value in values.items() if not value or (name == "s" and not _finite(value))]
                if signal.tag == "signalReference" and values["id"] in gone:
                    lacking.append("signal")
                if lacking:
                    group.remove(signal)
                    gone |= {values["id"]} if signal.tag == "signal" else set()
                    what = f"{signal.tag} {values['id'] or '?'} of road {road.get('id')}"
                    notes.append(f"{what} is left out, as it has no {' and no '.join(lacking)} that can be read")
    return notes


def _finite(text: str) -> bool:
    """Returns whether a text is a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _swap_sides(root: ET.Element) -> None:
    """Numbers the lanes of an OpenDRIVE map, in place, as if those to the left of the reference line lay to its right.

    With option --lefthand, netconvert puts lanes of negative numbers, which lead along that line, to its left.
    """
    for tag, names in LANE_NUMBERS.items():
        for element in root.iter(tag):
            for name in names:
                if (value := element.get(name)) is not None and value.strip("-0"):
                    element.set(name, value.removeprefix("-") if value.startswith("-") else f"-{value}")
    for section in root.iter("laneSection"):
        sides = {side: section.find(side) for side in ("left", "right")}
        for side, other in (("left", "right"), ("right", "left")):
            if (group := sides[side]) is not None:
                group.tag = other
                group[:] = sorted(group, key=lambda lane: -int(lane.get("id", 0)))
        order = {"left": 0, "center": 1, "right": 2}
        section[:] = sorted(section, key=lambda group: order.get(group.tag, 3))


def _convert(
    options: Sequence[str],
    path: Path,
    folder: Path,
    outlines: Mapping[str, str],
    source: str,
    output: str = "--output-file",
) -> list[str]:
    command = [
        *(str(find_netconvert()), *options, output, "made.xml", "--precision", str(DECIMALS)),
        # keep the frame of the input
        *("--offset.disable-normalization", "--no-turnarounds"),
    ]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    net_file = folder / "made.xml"
    if done.returncode != 0 or not net_file.is_file():
        why = " ".join((done.stderr or done.stdout).split())
        raise InputError(f"netconvert refused {source}: {why}")
    # netconvert heads the file with the date and its command line, which would make every regeneration differ.
    net = re.sub(r"<!--.*?-->\n*", "", net_file.read_text(encoding="UTF-8"), count=1, flags=re.DOTALL)
    net = re.sub(r'(<header [^>]*?) date="[^"]*"', r"\1", net, count=1)
    for junction, outline in outlines.items():
        net = re.sub(rf'(<junction id="{re.escape(junction)}"[^>]*? shape=")[^"]*', rf"\g<1>{outline}", net, count=1)
    write_text(path, net)
    told = (done.stdout + done.stderr).splitlines()
    return [line.removeprefix("Warning: ").strip() for line in told if line.startswith("Warning")]
