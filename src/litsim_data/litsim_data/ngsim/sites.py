"""The four NGSIM sites: location, dates, periods, and frame ``map`` of each.

NGSIM publishes positions in feet of the NAD 83 State Plane zone of the site ("global") and along the road ("local").
Frame ``map`` is a RIGID transform of the global positions in metres, one per site, fixed here, and shared by converted
recordings and the nets that :mod:`litsim_data.maps` builds. x points along the main direction of the site (US-101:
downstream, south-east; I-80: downstream, north; Lankershim and Peachtree: northbound), y to its left.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from litsim_data.generic.mapping import FOOT
from litsim_sim.core.scene import BoolArray, FloatArray

EXTENT = 2500.0  # [m] largest distance of positions on a site from its anchor, along either axis
PERIOD_SLACK_S = 450.0  # largest difference between the start of a recording and that of its published period


@dataclass(frozen=True, eq=False)
class Site:
    """One site of NGSIM.

    Attributes:
        name: name used in file names.
        location: value of column Location in the portal's file.
        title: title for citations.
        date: local date of the recording.
        utc_offset_h: offset of local time at that date [h].
        periods: published periods by the local time of their start, "HHMM".
        yaw: rotation [rad] from global axes to frame map: a heading in frame map is the global one plus this.
        global_anchor: a point [m] in the State Plane zone.
        map_anchor: the same point [m] in frame map.
        urban: whether it is a street with intersections.
    """

    name: str
    location: str
    title: str
    date: str
    utc_offset_h: int
    periods: tuple[str, ...]
    yaw: float
    global_anchor: tuple[float, float]
    map_anchor: tuple[float, float]
    urban: bool

    @property
    def net(self) -> str:
        """File name of the SUMO net in this frame."""
        return f"{self.name}.net.xml"

    def map_from_global(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns x, y (n,) [m] in frame map of positions `x`, `y` (n,) [m] in the State Plane zone."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        dx, dy = x - self.global_anchor[0], y - self.global_anchor[1]
        return self.map_anchor[0] + cos * dx - sin * dy, self.map_anchor[1] + sin * dx + cos * dy

    def holds(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Returns the mask (n,) of the State Plane positions (n,) [m] that can be on this site."""
        return (np.abs(x - self.global_anchor[0]) < EXTENT) & (np.abs(y - self.global_anchor[1]) < EXTENT)

    def local_time(self, time_ms: int) -> datetime:
        """Returns the local time at the site of a Global_Time [ms since 1970, UTC]."""
        return datetime.fromtimestamp(time_ms / 1000.0, UTC) + timedelta(hours=self.utc_offset_h)

    def period(self, time_ms: int) -> str:
        """Returns the name "HHMM" of the published period that begins at about `time_ms`, else the local time."""
        begin = self.local_time(time_ms)
        for period in self.periods:
            nominal = begin.replace(hour=int(period[:2]), minute=int(period[2:]), second=0, microsecond=0)
            if abs((begin - nominal).total_seconds()) <= PERIOD_SLACK_S:
                return period
        return f"{begin:%H%M}"


US101 = Site(
    name="us101",
    location="us-101",
    title="US-101 southbound, Los Angeles, 2005-06-15",
    date="2005-06-15",
    utc_offset_h=-7,
    periods=("0750", "0805", "0820"),
    # Least-squares rigid fit of (Local_Y, -Local_X) to the global positions of frames 316-543, Local_Y 180-415 m.
    # Fixed, because nets/us101.net.xml lies in this frame.
    yaw=0.718612,
    global_anchor=(1966511.071, 570797.706),
    map_anchor=(297.468, -9.641),
    urban=False,
)
I80 = Site(
    name="i80",
    location="i-80",
    title="I-80 eastbound, Emeryville, 2005-04-13",
    date="2005-04-13",
    utc_offset_h=-7,
    periods=("1600", "1700", "1715"),
    # The carriageway points 97.5 degrees counter-clockwise from east where the site begins; the anchor is its left edge
    # there, where Local_X and Local_Y are about zero: x is about Local_Y, y about -Local_X, as on US-101.
    yaw=float(np.deg2rad(-97.5)),
    global_anchor=(6042832.6 * FOOT, 2133067.4 * FOOT),
    map_anchor=(0.0, 0.0),
    urban=False,
)
LANKERSHIM = Site(
    name="lankershim",
    location="lankershim",
    title="Lankershim Boulevard, Los Angeles, 2005-06-16",
    date="2005-06-16",
    utc_offset_h=-7,
    periods=("0830", "0845"),
    # Northbound points about 117 degrees counter-clockwise from east; the anchor is 34.139045 N, 118.362223 W.
    yaw=float(np.deg2rad(-117.0)),
    global_anchor=(6452059.0 * FOOT, 1873180.8 * FOOT),
    map_anchor=(0.0, 0.0),
    urban=True,
)
PEACHTREE = Site(
    name="peachtree",
    location="peachtree",
    title="Peachtree Street, Atlanta, 2006-11-08",
    date="2006-11-08",
    utc_offset_h=-5,
    periods=("1245", "1600"),
    # Northbound points about 94 degrees counter-clockwise from east; the anchor is 33.78476 N, 84.38302 W.
    yaw=float(np.deg2rad(-94.0)),
    global_anchor=(2230849.0 * FOOT, 1376809.0 * FOOT),
    map_anchor=(0.0, 0.0),
    urban=True,
)

SITES: dict[str, Site] = {site.name: site for site in (US101, I80, LANKERSHIM, PEACHTREE)}
"""All sites by name."""


def site_at(location: str) -> Site | None:
    """Returns the site of a value of column Location, in any spelling ("us-101", "US 101", "i80"); None if unknown."""
    plain = "".join(c for c in location.lower() if c.isalnum())
    return SITES.get(plain)


def site_of(time_ms: float, x: float, y: float, *, urban: bool) -> Site | None:
    """Returns the site at State Plane position x, y [m], or None.

    US-101 and Lankershim are close to each other: the date of `time_ms` [ms since 1970] decides between them, or else
    whether the file has the columns of an `urban` site.
    """
    near = [site for site in SITES.values() if site.holds(np.array([x]), np.array([y]))[0]]
    then = [site for site in near if f"{site.local_time(int(time_ms)):%Y-%m-%d}" == site.date]
    alike = [site for site in near if urban == site.urban]
    return next(iter(then or alike or near), None)
