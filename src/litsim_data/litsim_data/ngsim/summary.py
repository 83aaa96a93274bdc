"""Summary of an official NGSIM file, from one pass over it without conversion."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pandas as pd

from litsim_data.ngsim.periods import Clocks
from litsim_data.ngsim.reading import blocks, layout_of

SHOWN = ("vehicle_id", "frame", "time_ms", "local_x", "local_y", "length", "speed", "lane")
ROWS_SHOWN = 3


def summary(path: Path) -> str:
    """Returns the layout, first rows, and the rows, vehicles, times, mean speed and lanes of every recording, as text.

    Raises:
        InputError: it is not an official file, or a line cannot be used.
    """
    clocks, head, parts = Clocks(), "", []
    for rows in blocks(path, SHOWN):
        by_clock = rows.groupby(clocks.assign(rows, str(path)))
        head = head or rows[[*SHOWN]].head(ROWS_SHOWN).to_string(index=False, float_format="%.3f")
        parts.append(
            by_clock.agg(
                rows=("line", "size"),
                ids=("vehicle_id", set),
                first_ms=("time_ms", "min"),
                last_ms=("time_ms", "max"),
                speeds=("speed", "sum"),
                lanes=("lane", set),
            )
        )
    lines = [
        f"{path}: {layout_of(path).title}, {path.stat().st_size} bytes, {sum(int(p['rows'].sum()) for p in parts)} rows"
    ]
    lines += ["first rows, in SI units:", head, "recordings:"]
    shared = Counter(period.clock for period in clocks.periods())
    for period in clocks.periods():
        mine = pd.DataFrame([part.loc[period.clock] for part in parts if period.clock in part.index])
        count, site = int(mine["rows"].sum()), period.site
        note = f" (of all {shared[period.clock]} of this clock)" if shared[period.clock] > 1 else ""
        begin, end = (site.local_time(int(time_ms)) for time_ms in (mine["first_ms"].min(), mine["last_ms"].max()))
        lanes = ", ".join(map(str, sorted(set.union(*mine["lanes"]))))
        lines.append(
            f"  {period.name:<18}{count} rows{note}, {len(set.union(*mine['ids']))} ids, {begin:%H:%M:%S} to "
            f"{end:%H:%M:%S} local, mean speed {mine['speeds'].sum() / count:.1f} m/s, lanes {lanes}"
        )
    return "\n".join(lines)
