"""Description of a recording, as commands print it."""

from __future__ import annotations

from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.scenario.recording import Recording

LONG_NOTES = ("mapping", "ids", "moved_by_cleaning_m")  # notes of a header that are whole tables


def describe(recording: Recording) -> str:
    """Returns the description of a recording, as text."""
    header, table = recording.header, recording.table
    vehicles = table.drop_duplicates("vehicle_id")
    per_frame = table.groupby("frame").size()
    kinds = {kind.name.lower(): int((vehicles["kind"] == kind).sum()) for kind in Kind}
    first, last = int(table["frame"].min()), int(table["frame"].max())
    span = ", ".join(f"{axis} {table[axis].min():.1f} to {table[axis].max():.1f} m" for axis in ("x", "y"))
    rows = {
        "name": header.name,
        "source": header.source,
        "licence": header.licence,
        "net": header.net,
        "frames": f"{first} to {last} ({(last - first) * STEP_S:.1f} s at {header.rate_hz:g} Hz), {len(table)} rows",
        "vehicles": f"{len(vehicles)} ({', '.join(f'{count} {kind}' for kind, count in kinds.items() if count)})",
        "at a time": f"{per_frame.min()} to {per_frame.max()}, mean {per_frame.mean():.1f}",
        "speed": f"mean {table['speed'].mean():.1f}, {table['speed'].min():.1f} to {table['speed'].max():.1f} m/s",
        "extent": span,
        "notes": ", ".join(f"{key}: {value}" for key, value in header.notes.items() if key not in LONG_NOTES),
    }
    return "\n".join(f"{name:<11}{value}" for name, value in rows.items() if value)
