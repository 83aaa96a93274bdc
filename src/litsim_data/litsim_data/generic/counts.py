"""Counts of a conversion: how many rows and tracks were used, changed or left out, and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

SHOWN = 5  # most vehicles that a line names


@dataclass
class Counts:
    """Rows and tracks of one conversion, and what else there is to tell of it.

    Attributes:
        read: rows of the file.
        left_out: rows left out, by reason.
        tracks: vehicles of the remaining rows.
        jumps: jumps at which tracks were cut.
        pieces: tracks after cutting at long holes and jumps.
        too_short: pieces that contain no frame at 10 Hz.
        rows: rows of the recording, one per vehicle and frame at 10 Hz.
        leaps: how many steps depart from the motion around as no vehicle does, and where one does most; empty for none.
        lines: what else :meth:`tell` was told.
        notes: the same, as notes for the header of the recording.
    """

    read: int = 0
    left_out: dict[str, int] = field(default_factory=dict)
    tracks: int = 0
    jumps: int = 0
    pieces: int = 0
    too_short: int = 0
    rows: int = 0
    leaps: str = ""
    lines: list[str] = field(default_factory=list)
    notes: dict[str, Any] = field(default_factory=dict)

    def leave_out(self, reason: str, rows: int) -> None:
        """Counts `rows` that are left out for `reason`; does nothing for 0."""
        if rows:
            self.left_out[reason] = self.left_out.get(reason, 0) + int(rows)

    def tell(self, topic: str, text: str, **notes: Any) -> None:
        """Takes a line of text on a topic, and notes for the header."""
        self.lines.append(f"{topic:<11}{text}")
        self.notes |= notes

    def note(self) -> dict[str, Any]:
        """Returns the counts as notes for the header of the recording."""
        return {
            "rows_read": self.read,
            "rows_left_out": self.left_out,
            "tracks": self.tracks,
            "tracks_after_cuts": self.pieces,
            "tracks_too_short": self.too_short,
            **({"jumps": self.jumps} if self.jumps else {}),
            **self.notes,
            "rows_at_10_hz": self.rows,
        }

    def text(self) -> str:
        """Returns the counts as text, one line per event."""
        used = self.read - sum(self.left_out.values())
        left_out = [f"left out   {rows} rows: {reason}" for reason, rows in self.left_out.items()]
        where = f"long holes and {self.jumps} jumps" if self.jumps else "long holes"
        cut = f", {self.pieces} after {where} were cut" if self.pieces > self.tracks else ""
        short = f", {self.too_short} of them left out: seen between two frames of 10 Hz only" if self.too_short else ""
        return "\n".join(
            [
                f"rows       {self.read} read, {used} used, {self.rows} at 10 Hz",
                *left_out,
                *self.lines,
                f"tracks     {self.tracks}{cut}{short}",
            ]
        )
