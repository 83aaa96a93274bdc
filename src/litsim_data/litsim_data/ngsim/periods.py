"""Assignment of rows to NGSIM's recordings: by site, and by period.

Every period was recorded separately: frame numbers and ids start again, so one Vehicle_ID in two periods is two
vehicles. Periods overlap in time (US-101's second begins before the last vehicle of the first has left), so gaps in
time do not separate them; the time of frame 0, the same for all rows of a period, does. Where one clock runs through
several periods, two minutes without vehicles separate them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from litsim_data.ngsim.sites import SITES, Site
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import RATE_HZ, IntArray

CLOCK_SLACK_MS = 30_000  # largest difference between times of frame 0 of one clock
CLOCKS_MAX = 64  # NGSIM has about ten; more mean that frames and times do not belong together
MINUTE_MS = 60_000


@dataclass
class Clock:
    """Rows of one site with one time of frame 0.

    Attributes:
        site: name of the site.
        origin_ms: time of frame 0 [ms since 1970].
        minutes: minutes since 1970 with rows.
    """

    site: str
    origin_ms: int
    minutes: set[int] = field(default_factory=set)


@dataclass(frozen=True)
class Period:
    """One recording: a stretch of a clock's rows without a break.

    Attributes:
        name: unique name, such as us101_0750.
        site: its site.
        clock: index of its clock.
        minutes: first and last minute since 1970.
    """

    name: str
    site: Site
    clock: int
    minutes: tuple[int, int]

    def holds(self, time_ms: IntArray) -> np.ndarray:
        """Returns the mask (n,) of the times `time_ms` (n,) [ms] of its clock that belong to this period."""
        minute = time_ms // MINUTE_MS
        return (minute >= self.minutes[0]) & (minute <= self.minutes[1])


class Clocks:
    """The clocks of a file, in order of appearance."""

    def __init__(self) -> None:
        self.clocks: list[Clock] = []

    def assign(self, rows: pd.DataFrame, where: str) -> IntArray:
        """Returns the index (n,) of the clock of every row of :func:`.reading.blocks`; new clocks are added.

        Raises:
            InputError: there are more clocks than NGSIM can have.
        """
        names = list(SITES)
        time_ms, frame = rows["time_ms"].to_numpy(), rows["frame"].to_numpy()
        origins = time_ms - np.round(1000.0 / RATE_HZ * frame).astype(np.int64)
        pairs, unique = pd.factorize(pd.MultiIndex.from_arrays([rows["site"], origins]), sort=True)
        index = np.array([self._find(names[site], int(origin)) for site, origin in unique], np.int64)[pairs]
        if len(self.clocks) > CLOCKS_MAX:
            row = int(np.argmax(index >= CLOCKS_MAX))
            raise InputError(
                f"{where}: line {rows['line'].iloc[row]}: Frame_ID {frame[row]} at Global_Time {time_ms[row]}: "
                f"frames and times do not run together at 10 Hz; {len(self.clocks)} different times of frame 0"
            )
        for code in np.unique(index):
            self.clocks[code].minutes.update(np.unique(time_ms[index == code] // MINUTE_MS).tolist())
        return index

    def _find(self, site: str, origin_ms: int) -> int:
        for code, clock in enumerate(self.clocks):
            if clock.site == site and abs(clock.origin_ms - origin_ms) <= CLOCK_SLACK_MS:
                return code
        self.clocks.append(Clock(site, origin_ms))
        return len(self.clocks) - 1

    def periods(self) -> list[Period]:
        """Returns the recordings, sorted by site and time, with unique names."""
        stretches = []
        for code, clock in enumerate(self.clocks):
            minutes = np.array(sorted(clock.minutes))
            pieces = np.split(minutes, np.flatnonzero(np.diff(minutes) > 2) + 1)
            stretches += [(clock.site, int(piece[0]), int(piece[-1]), code) for piece in pieces]
        order = list(SITES)
        periods: list[Period] = []
        for name, first, last, code in sorted(stretches, key=lambda s: (order.index(s[0]), s[1], s[3])):
            site = SITES[name]
            title = f"{name}_{site.period(first * MINUTE_MS)}"
            same = sum(period.name == title or period.name.startswith(f"{title}_") for period in periods)
            periods.append(Period(f"{title}_{same + 1}" if same else title, site, code, (first, last)))
        return periods
