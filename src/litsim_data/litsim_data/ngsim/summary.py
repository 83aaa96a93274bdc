"""Summary of an official NGSIM file, from one pass over it without conversion."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from litsim_data.ngsim import official as ngsim
from litsim_data.ngsim.periods import Clocks

SHOWN = ("vehicle_id", "frame", "time_ms", "local_x", "local_y", "length", "speed", "lane")
ROWS_SHOWN = 3


@dataclass
class _Seen:
    """Figures of the rows of one clock read so far."""

    rows: int = 0
    vehicles: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    first_ms: int = 2**62
    last_ms: int = 0
    speed_sum: float = 0.0
    lanes: set[int] = field(default_factory=set)

    def add(self, columns: dict[str, np.ndarray], rows: np.ndarray) -> None:
        time_ms = columns["time_ms"][rows]
        self.rows += len(time_ms)
        self.vehicles = np.union1d(self.vehicles, columns["vehicle_id"][rows])
        self.first_ms, self.last_ms = min(self.first_ms, int(time_ms.min())), max(self.last_ms, int(time_ms.max()))
        self.speed_sum += float(columns["speed"][rows].sum())
        self.lanes |= set(np.unique(columns["lane"][rows]).tolist())


def summary(path: Path, *, progress: bool = False) -> str:
    """Text with layout, first rows, and the rows, vehicles, times, mean speed and lanes of every recording.

    Raises:
        InputError: it is not an official file, or a line cannot be used.
    """
    layout = ngsim.layout_of(path)
    clocks = Clocks()
    seen: dict[int, _Seen] = {}
    head: list[str] = []
    for columns in ngsim.blocks_of(path, layout, list(SHOWN), progress=progress):
        index = clocks.assign(columns, str(path))
        if not head:
            head = _first_rows(columns)
        for code in np.unique(index):
            seen.setdefault(int(code), _Seen()).add(columns, index == code)
    lines = [f"{path}: {layout.title}, {path.stat().st_size} bytes, {sum(one.rows for one in seen.values())} rows"]
    lines += ["first rows, in SI units:", *head, "recordings:"]
    shared: dict[int, int] = {}
    for period in clocks.periods():
        shared[period.clock] = shared.get(period.clock, 0) + 1
    for period in clocks.periods():
        one, site = seen[period.clock], period.site
        note = f" (of all {shared[period.clock]} of this clock)" if shared[period.clock] > 1 else ""
        begin, end = (f"{site.local_time(time_ms):%H:%M:%S}" for time_ms in (one.first_ms, one.last_ms))
        lanes = ", ".join(map(str, sorted(one.lanes)))
        lines.append(
            f"  {period.name:<18}{one.rows} rows{note}, {len(one.vehicles)} ids, {begin} to {end} local, mean speed "
            f"{one.speed_sum / one.rows:.1f} m/s, lanes {lanes}"
        )
    return "\n".join(lines)


def _first_rows(columns: dict[str, np.ndarray]) -> list[str]:
    count = min(ROWS_SHOWN, len(columns["line"]))
    cells = [[name, *(f"{columns[name][row]:.13g}" for row in range(count))] for name in SHOWN]
    return ["  " + "".join(f"{cell:>15}" for cell in row) for row in zip(*cells, strict=True)]
