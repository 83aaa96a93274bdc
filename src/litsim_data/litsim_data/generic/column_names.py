"""Names of columns of tables: what those of a file most probably mean."""

from __future__ import annotations

import re

from litsim_sim.core.errors import InputError
from litsim_sim.io.table_input import TableFiles

OF = r"(vehicle|veh|car|object|obj|actor|agent|track|timestep)_?"
"""What many names begin with, in lower case: ``vehicle_x`` of SUMO's trajectories is an x."""
PLACE = r"(local|pos(ition)?|utm|map|translation|location|cent(er|re))_?"
NAMES: dict[str, str] = {
    "vehicle_id": r"(vehicle|track|agent|actor|object|car|obj|veh|instance)?_?(id|uuid|token|idx|index)",
    "time": rf"({OF}|global_?)?(time|timestamp|stamp)(_?(s|ms|us|ns|sec|seconds|micros|millis|nanos))?|t|total_nanos",
    "frame": r"frame(_?(id|number|num|no))?|(time_?)?step",
    "x": rf"({OF})?({PLACE})?t?x(_?(center|centre|m|ft|pos|position|utm))?|(utm_?)?east(ing)?",
    "y": rf"({OF})?({PLACE})?t?y(_?(center|centre|m|ft|pos|position|utm))?|(utm_?)?north(ing)?",
    "length": rf"({OF}|v_?)?(length|size_?l)(_?(m|ft|cm))?",
    "width": rf"({OF}|v_?)?(width|size_?w)(_?(m|ft|cm))?",
    "yaw": rf"({OF}|utm_?)?(yaw|heading|course|psi|theta|orientation|angle)(_?(rad|deg))?",
    "speed": rf"({OF})?(speed|velocity)|v|v_?vel|lon_?velocity|speed_?(ms|mps|kmh|kph|km_h|mph|m_s)",
    "speed_x": r"v(el|elocity)?_?x|x_?v(el|elocity)|speed_?x",
    "speed_y": r"v(el|elocity)?_?y|y_?v(el|elocity)|speed_?y",
    "acceleration": r"(lon_?)?(acceleration|accel|acc)(_?(mps2|m_?s2))?|v_?acc",
    "kind": r"(agent|actor|object|obj|vehicle|track|v)?_?(type|class|kind|category)(_?(id|name))?|classification",
    "lane": rf"({OF})?lane(_?id)?",
    "clip": r"(case|clip|recording|scenario|scene|sequence|file|log)_?(id|no|number)?",
}
"""Pattern of a file's column names, in lower case with words joined by underscores or nothing, by our name."""
FEET, METRES = r"(ft|feet)$", r"[_x]m$|utm|east"
"""Pattern of names of a column of positions, in lower case, that tell their unit."""
GEOGRAPHIC = {"x": rf"({OF})?({PLACE})?(lon(gitude)?|lng)", "y": rf"({OF})?({PLACE})?lat(itude)?"}
"""Pattern of column names, in lower case, of positions on earth, which are used where there are no others."""
COMPONENTS = ("speed_x", "speed_y")
HEIGHT = "height"
"""Column of image boxes with their extent across the road; column width is their extent along it."""
SUMO_X = "vehicle_x"
"""Column of SUMO's trajectories (option --fcd-output, by xml2csv)."""
IDENTITY = ("vehicle_id", "x", "y")


def named_columns(source: TableFiles) -> dict[str, str]:
    """Returns the file's columns by our names; the first of several that match, of positions first with a unit.

    Raises:
        InputError: none is like an id, a position or a time.
    """
    named: dict[str, str] = {}
    with_unit = sorted(source.columns, key=lambda name: not re.search(rf"{FEET}|{METRES}", name.lower()))
    for ours, pattern in NAMES.items():
        for theirs in with_unit if ours in ("x", "y") else source.columns:
            if theirs not in named.values() and re.fullmatch(pattern, plain_name(theirs)):
                named[ours] = theirs
                break
    if "time" in named:
        named.pop("frame", None)
    if not {"x", "y"} <= {*named}:
        for ours, pattern in GEOGRAPHIC.items():
            degrees = [name for name in source.columns if re.fullmatch(pattern, plain_name(name))]
            named |= {ours: degrees[0]} if degrees else {}
    if "speed" in named or not {*COMPONENTS} <= {*named}:
        for name in COMPONENTS:
            named.pop(name, None)
    if "length" not in named and "width" in named and HEIGHT in source.columns:  # of boxes along x, as in highD
        named |= {"length": named["width"], "width": HEIGHT}
    missing = [name for name in IDENTITY if name not in named]
    missing += [] if "time" in named or "frame" in named else ["time or frame"]
    if missing:
        raise InputError(
            f"{source}: no column looks like {', '.join(missing)}; the file has {list(source.columns)}; write the "
            f"mapping by hand (docs/data.md)"
        )
    return named


def plain_name(column: str) -> str:
    """Returns a column's name in lower case, with its words joined by underscores."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", column.strip()).lower().replace(" ", "_").replace("-", "_")
