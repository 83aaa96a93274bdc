"""Counts of a conversion: how many rows and tracks were used, changed or left out, and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from litsim_data.cleaning.noise import HARSH_SHARE

SHOWN = 5  # most vehicles that a line names


@dataclass
class Counts:
    """Rows and tracks of one conversion.

    Attributes:
        read: rows of the file.
        left_out: rows left out, by reason.
        unknown: vehicles of each kind of the file that the mapping calls unknown.
        changing: tracks whose rows are of several kinds, by the mapping.
        kindless: vehicles, if the mapping names no column of kinds.
        of_one_size: trucks and motorcycles whose size is a number of the mapping, which holds for all vehicles.
        tracks: vehicles of the remaining rows.
        jumps: jumps at which tracks were cut.
        pieces: tracks after cutting at long holes and jumps.
        too_short: pieces that contain no frame at 10 Hz.
        usual_sizes: agents without a usable size that got a default one.
        accepted: what checks find that the mapping accepts.
        backwards: rows with negative speeds, set to 0.
        leaps: steps between rows of vehicles that depart from the motion around as no vehicle does.
        farthest_leap: how far and where one of them does most.
        off_motion: vehicles whose headings are off their motion, and follow from it.
        turns: steps between rows of vehicles at which the file's heading turns as no vehicle does.
        largest_turn: how far and where it turns most.
        harsh: share of the rows of vehicles with implausibly hard accelerations.
        noisy: what cleaning has changed of motion that was too noisy; empty for nothing, and where it was asked for.
        moved: largest displacement by cleaning [m], by vehicle, of those moved by more than a metre.
        overlaps: how long two vehicles overlap [s], if for a second or more, by their ids.
        levels: a sentence on vehicles on different levels, empty for none.
        joined: vehicles of trailers that became one box with them, by the trailer's id.
        towed: vehicles of trailers that are still tracks of their own, likewise.
        rows: rows of the recording, one per vehicle and frame at 10 Hz.
    """

    read: int = 0
    left_out: dict[str, int] = field(default_factory=dict)
    unknown: dict[str, int] = field(default_factory=dict)
    changing: int = 0
    kindless: int = 0
    of_one_size: int = 0
    tracks: int = 0
    jumps: int = 0
    pieces: int = 0
    too_short: int = 0
    usual_sizes: int = 0
    accepted: list[str] = field(default_factory=list)
    backwards: int = 0
    leaps: int = 0
    farthest_leap: str = ""
    off_motion: list[int] = field(default_factory=list)
    turns: int = 0
    largest_turn: str = ""
    harsh: float = 0.0
    noisy: str = ""
    moved: dict[int, float] = field(default_factory=dict)
    overlaps: dict[tuple[int, int], float] = field(default_factory=dict)
    levels: str = ""
    joined: dict[int, int] = field(default_factory=dict)
    towed: dict[int, int] = field(default_factory=dict)
    rows: int = 0

    def leave_out(self, reason: str, rows: int) -> None:
        """Counts `rows` that are left out for `reason`; does nothing for 0."""
        if rows:
            self.left_out[reason] = self.left_out.get(reason, 0) + int(rows)

    def note(self) -> dict[str, Any]:
        """Returns the counts as notes for the header of the recording."""
        if_any = {
            "jumps": self.jumps,
            "tracks_of_usual_size": self.usual_sizes,
            "rows_backwards": self.backwards,
            "leaps": self.leaps,
            "headings_from_motion": self.off_motion,
            "turns": self.turns,
            "noise": self.noisy,
            "moved_by_cleaning_m": {str(vehicle): round(way, 2) for vehicle, way in self.moved.items()},
            "pairs_that_overlap": len(self.overlaps),
            "trailers_joined": {str(trailer): vehicle for trailer, vehicle in self.joined.items()},
            "trailers_apart": {str(trailer): vehicle for trailer, vehicle in self.towed.items()},
        }
        return {
            "rows_read": self.read,
            "rows_left_out": self.left_out,
            "tracks": self.tracks,
            "tracks_after_cuts": self.pieces,
            "tracks_too_short": self.too_short,
            **{name: count for name, count in if_any.items() if count},
            "rows_at_10_hz": self.rows,
        }

    def text(self) -> str:
        """Returns the counts as text, one line per event."""
        used = self.read - sum(self.left_out.values())
        lines = [f"rows       {self.read} read, {used} used, {self.rows} at 10 Hz"]
        lines += [f"left out   {rows} rows: {reason}" for reason, rows in self.left_out.items()]
        where = f"long holes and {self.jumps} jumps" if self.jumps else "long holes"
        cut = f", {self.pieces} after {where} were cut" if self.pieces > self.tracks else ""
        short = f", {self.too_short} of them left out: seen between two frames of 10 Hz only" if self.too_short else ""
        if self.unknown:
            kinds = ", ".join(f"{name or 'empty'} {vehicles}" for name, vehicles in self.unknown.items())
            vehicles = f"{sum(self.unknown.values())} vehicles are of a kind"
            lines.append(f"unknown    {vehicles} that field kinds of the mapping calls unknown: {kinds}")
        if self.changing:
            lines.append(f"kinds      {self.changing} tracks change their kind: each is what most of its rows say")
        if self.kindless:
            lines.append(
                f"unknown    {self.kindless} vehicles, as the mapping has no field columns.kind: pedestrians and "
                f"cyclists among them, too, are vehicles then"
            )
        if self.of_one_size:
            lines.append(
                f"sizes      {self.of_one_size} trucks or motorcycles have the size of all vehicles that fields "
                f"columns.length and columns.width of the mapping give as numbers"
            )
        if self.usual_sizes:
            lines.append(f"sizes      {self.usual_sizes} agents without a usable size got a usual one of their kind")
        lines += [f"accepted   {finding}" for finding in self.accepted]
        if self.backwards:
            lines.append(f"speeds     {self.backwards} rows below 0, of reversing or standing vehicles, became 0")
        if self.leaps:
            lines.append(
                f"leaps      {self.leaps} times a vehicle departs from its motion before and after as none drives, at "
                f"most {self.farthest_leap}: speeds and headings there may be wrong, too"
            )
        if self.off_motion:
            ids = ", ".join(map(str, self.off_motion[:SHOWN]))
            lines.append(
                f"headings   {len(self.off_motion)} vehicles drive off their heading for 15 m and more, such as {ids}: "
                "their headings follow from the motion"
            )
        if self.turns:
            lines.append(
                f"turns      {self.turns} times the heading of a vehicle turns as none does, at most "
                f"{self.largest_turn}: without field columns.yaw headings follow from the motion"
            )
        lines += self._motion()
        if self.overlaps:
            (first, second), seconds = max(self.overlaps.items(), key=lambda item: item[1])
            lines.append(
                f"overlaps   {len(self.overlaps)} pairs of vehicles overlap for a second or more, above all {first} "
                f"and {second} for {seconds:.1f} s: is one of them there twice, or are sizes too large?"
            )
        lines += self._together()
        return "\n".join([*lines, f"tracks     {self.tracks}{cut}{short}"])

    def _motion(self) -> list[str]:
        """Returns lines on rough motion, and on what cleaning has changed."""
        lines = []
        if self.harsh > HARSH_SHARE:
            share = f"{self.harsh:.0%} of the accelerations are beyond 5 m/s2"
            lines.append(f"rough      {share}: field clean of the mapping, set to true, smooths positions")
        if self.noisy:
            lines.append(f"noisy      cleaned: {self.noisy}")
        if self.moved:
            worst = sorted(self.moved, key=lambda vehicle: -self.moved[vehicle])[:SHOWN]
            ways = ", ".join(f"{vehicle} by {self.moved[vehicle]:.1f} m" for vehicle in worst)
            lines.append(
                f"cleaned    {len(self.moved)} vehicles are moved by more than 1 m, above all {ways}: do they reverse?"
            )
        return lines

    def _together(self) -> list[str]:
        """Returns lines on vehicles on different levels, and on trailers."""
        lines = [f"levels     {self.levels}"] if self.levels else []
        if self.joined:
            lines.append(f"trailers   one box with the vehicle that tows them: {_pairs(self.joined)}")
        if self.towed:
            lines.append(
                f"trailers   {_pairs(self.towed)}: tracks of their own, as they turn against the vehicle; they part if "
                f"a run takes one of the two over"
            )
        return lines


def _pairs(towed: dict[int, int]) -> str:
    """Returns a text on trailers and their vehicles."""
    named = [f"{trailer} of {vehicle}" for trailer, vehicle in sorted(towed.items())]
    return ", ".join(named[:SHOWN]) + (f" and {len(named) - SHOWN} more" if len(named) > SHOWN else "")
