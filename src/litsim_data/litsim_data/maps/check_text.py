"""The result of a net's check as text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from litsim_data.maps.alignment import START_SHIFTS, START_TURNS, Alignment, explained
from litsim_data.maps.check import NetCheck
from litsim_data.maps.connectivity import Connectivity
from litsim_data.maps.placement import Placement


def describe(
    check: NetCheck, transform: Mapping[str, Any] | None = None, origin: tuple[float, float] | None = None
) -> str:
    """Returns the result as lines of text: tables of placements and of the worst misses, and what else was found.

    Args:
        check: the result.
        transform: field `transform` of the mapping that the recording was made with; None where there was no mapping.
        origin: latitude and longitude of the site [degrees], for what a turn may come from.
    """
    lines = [f"{'part':<28}{'rows':>8}{'on a lane':>11}{'on named':>10}{'label ok':>10}{'offset m':>10}"]
    for name, part in check.placements.items():
        named = f"{part.inside_named:>10.2%}{part.agreement:>10.2%}" if part.named else f"{'-':>10}{'-':>10}"
        lines.append(f"{name:<28}{part.rows:>8}{part.inside:>11.2%}{named}{part.offset:>10.2f}")
    for name, part in check.placements.items():
        lines += _misses(name, part)
    for name, alignment in check.alignments.items():
        lines += _alignment(name, alignment, transform, origin)
    lines += _connectivity(check.lanes, check.connectivity)
    lines.append(f"SUMO: {'; '.join(check.warnings) or 'loads without warnings'}")
    lines += [f"MISSED: {missed}" for missed in check.failures]
    return "\n".join(lines)


def _misses(name: str, part: Placement) -> list[str]:
    if not part.worst:
        return []
    past = f"{part.past_end:.0%} of these positions past the ends of the nearest lane"
    lines = [f"{name}: {part.missing} vehicles have been on no lane, {past}; the worst of each, in frame map:"]
    columns = ("", "vehicle", "time s", "frame", "x m", "y m", "beyond m")
    lines.append("  {:>3}{:>9}{:>9}{:>8} {:>11} {:>11} {:>11}  nearest lane".format(*columns))
    for number, miss in enumerate(part.worst, 1):
        lines.append(
            f"  {number:>3}{miss.vehicle:>9}{miss.time_s:>9.1f}{miss.frame:>8} {miss.x:>11.2f} {miss.y:>11.2f} "
            f"{miss.beyond:>11.2f}  {miss.lane}{', past its end' if miss.past_end else ''}"
        )
    return lines


def _alignment(
    name: str, alignment: Alignment, transform: Mapping[str, Any] | None, origin: tuple[float, float] | None
) -> list[str]:
    degrees, far = math.degrees(alignment.turn), math.hypot(*alignment.shift)
    before = transform or {}
    yaw_deg, x, y = (float(before.get(key, 0.0)) for key in ("yaw_deg", "x", "y"))
    if alignment.lost:
        reach = f"{START_SHIFTS[-1]:.0f} m and {math.degrees(START_TURNS[-1]):.0f} degrees"
        most = f"{max(alignment.before, alignment.after):.1%}"
        x, y = x + alignment.net_centre[0] - alignment.centre[0], y + alignment.net_centre[1] - alignment.centre[1]
        return [
            f"{name}: no motion of about {reach} puts more than {most} of it on lanes of its direction",
            f"  for another check with the middle of both together, {_as_field(before, yaw_deg, x, y)}",
        ]
    if alignment.in_place:
        return [f"{name}: in place; the best fit is {far:.2f} m and {degrees:+.2f} degrees off"]
    centre, shift = (
        f"({vector[0]:{sign}.2f}, {vector[1]:{sign}.2f})"
        for vector, sign in ((alignment.centre, ""), (alignment.shift, "+"))
    )
    along = "" if alignment.determined else "; the lanes do not tell how far along them"
    lines = [f"{name}: lies best turned by {degrees:+.2f} degrees about {centre} and shifted by {shift} m{along}"]
    lines.append(
        f"  then {alignment.after:.1%} of the positions are on a lane of their direction, now {alignment.before:.1%}"
    )
    if why := explained(alignment.turn, origin):
        lines.append(f"  {why}")
    lines.append(f"  {_as_field(before, *alignment.transform(yaw_deg, x, y))}")
    return lines


def _as_field(before: Mapping[str, Any], yaw_deg: float, x: float, y: float) -> str:
    mirrored = "mirror_y: true, " if before.get("mirror_y") else ""
    return f"as a mapping's transform: {{{mirrored}yaw_deg: {yaw_deg:.10g}, x: {x:.2f}, y: {y:.2f}}}"


def _connectivity(lanes: int, connectivity: Connectivity) -> list[str]:
    without = ", ".join((*(gap.lane for gap in connectivity.gaps), *connectivity.unreached)) or "none"
    ends = f"; ending early: {', '.join(connectivity.ending)}" if connectivity.ending else ""
    begins = f"; beginning late: {', '.join(connectivity.beginning)}" if connectivity.beginning else ""
    stuck = ", ".join(connectivity.stuck) or "none"
    crossings = ", ".join(f"{crossing.one} and {crossing.other}" for crossing in connectivity.crossings) or "none"
    return [
        f"lanes: {lanes}, without exit: {stuck}, without a way in: {without}{ends}{begins}",
        f"edges that cross without a junction: {crossings}",
    ]
