"""Maps in the formats of others, part by part: roads of OpenDRIVE, and lanelets of CommonRoad."""

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from litsim_data.exports.export import add
from litsim_data.maps.lane_graph import Lanelet

LANE = '<lane id="{0}" type="driving" level="false">{1}<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'


def road(
    number: int = 1,
    begin: tuple[float, float] = (-150.0, 0.0),
    length: float = 300.0,
    left: int = 1,
    right: int = 1,
    *,
    rule: str = "",
    link: str = "",
    lane_link: str = "",
    shape: str = "<line/>",
    offset: str = "",
    more: str = "",
) -> str:
    """A road along x with lanes of 3.5 m on both sides, each with `lane_link` formatted with its number."""
    sides = {"left": range(left, 0, -1), "center": [0], "right": range(-1, -right - 1, -1)}
    lanes = {side: "".join(LANE.format(one, lane_link.format(one)) for one in ids) for side, ids in sides.items()}
    lanes["center"] = '<lane id="0" type="none" level="false"/>'
    section = "".join(f"<{side}>{inside}</{side}>" for side, inside in lanes.items() if inside)
    return (
        f'<road name="" length="{length}" id="{number}" junction="-1"{rule}><link>{link}</link><planView>'
        f'<geometry s="0" x="{begin[0]}" y="{begin[1]}" hdg="0" length="{length}">{shape}</geometry></planView>'
        f'<lanes>{offset}<laneSection s="0">{section}</laneSection></lanes>{more}</road>'
    )


def opendrive(*parts: str) -> str:
    """A file of roads and junctions; by default that of one road."""
    return f'<OpenDRIVE><header revMajor="1" revMinor="7"/>{"".join(parts or [road()])}</OpenDRIVE>'


def add_lanelets(root: ET.Element, lanelets: Sequence[Lanelet]) -> dict[str, ET.Element]:
    """The elements of CommonRoad that lanelets become in `root`, numbered from 100 on, by the names of the lanelets."""
    numbers = {one.id: 100 + at for at, one in enumerate(lanelets)}
    elements = {one.id: add(root, "lanelet", id=numbers[one.id]) for one in lanelets}
    for one in lanelets:
        for name, bound in (("leftBound", one.left), ("rightBound", one.right)):
            side = add(elements[one.id], name)
            for x, y in bound:
                point = add(side, "point")
                add(point, "x", x), add(point, "y", y)
        for other in one.successors:
            add(elements[one.id], "successor", ref=numbers[other])
        for name, neighbour in (("adjacentLeft", one.left_id), ("adjacentRight", one.right_id)):
            if neighbour:
                add(elements[one.id], name, ref=numbers[neighbour], drivingDir="same")
    return elements
