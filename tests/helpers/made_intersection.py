"""A made-up signalised intersection, in the form of a user's own recording, for docs/your-own-recording.md.

``./litsim exec python tests/helpers/made_intersection.py FOLDER`` writes a Lanelet2 map, the raw tracks and the states
of the signals there. Four arms cross, each with a lane for left turns and one for all else. Drivers follow the
intelligent driver model, stop for red, and turn left where oncoming traffic leaves a gap. Nothing in it is real.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from litsim_sim.cli.program import program
from litsim_sim.core.errors import not_installed
from litsim_sim.core.scene import FloatArray

ORIGIN = (49.0102, 8.4204)
"""Latitude and longitude of the middle of the junction, degrees."""

OFFSET = (634.5, 287.25)
"""The middle of the junction in the recorders' axes: easting and northing from their own origin [m]."""

TURN = 0.437
"""Turn of their axes against those of the map's UTM, whose north is not the true one there [deg]."""

CLOCK_MS = 36_000_000
"""Time of their clock at the beginning of the recording."""

LANE, STOP, ARM, SEEN = (
    3.5,
    16.0,
    140.0,
    95.0,
)  # [m] width; from the middle: stop lines, ends of lanes, of the camera's view
ARMS = {"west": 8.0, "south": 98.0, "east": 188.0, "north": 278.0}
"""Driving direction from each arm into the junction, counter-clockwise from east [deg]."""
TURNS = {"left": 1, "through": 0, "right": -1}
GROUPS = {"west": "K1", "south": "K2", "east": "K3", "north": "K4"}
PEDESTRIANS = "F1"
GREEN, AMBER, RED = 1, 2, 0
"""Their names in the file of states."""
PHASES = ((16.0, "we"), (3.0, "we amber"), (2.0, ""), (13.0, "sn"), (3.0, "sn amber"), (2.0, ""))
"""Duration [s], and the groups that have green or amber."""
CYCLE = sum(seconds for seconds, _ in PHASES)
STEP, WARM_UP, SECONDS = 0.08, 42.0, 90.0
SPEED, HEADWAY, GAP, ACCELERATION, BRAKING = 12.0, 1.3, 2.0, 1.6, 2.2
FREE = 4.0  # [s] smallest time gap to oncoming vehicles for a left turn
WAIT = 8.0  # [m] distance beyond the stop line at which a left-turning vehicle waits for it


def _turned(points: FloatArray, degrees: float) -> FloatArray:
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return points @ np.array([[cos, sin], [-sin, cos]])


@dataclass(frozen=True)
class Strip:
    """A lanelet: its bounds (k, 2) in driving direction [m], the middle of the junction at (0, 0)."""

    number: int
    left: FloatArray
    right: FloatArray
    arm: str
    turn: str = ""
    entry: bool = False

    @cached_property
    def middle(self) -> FloatArray:
        return 0.5 * (self.left + self.right)


def strips() -> list[Strip]:
    """Two lanes into the junction and two out of it on every arm, and three ways over it from every arm."""
    made: list[Strip] = []
    for place, (arm, degrees) in enumerate(ARMS.items(), 1):
        for lane in (0, 1):  # from the middle of the road
            x = np.array([-ARM, -STOP])
            bounds = [np.column_stack([x, np.full(2, -LANE * (lane + side))]) for side in (0, 1)]
            made.append(Strip(100 * place + lane, *(_turned(b, degrees) for b in bounds), arm, entry=True))
            out = [np.column_stack([x[::-1], np.full(2, LANE * (lane + side))]) for side in (0, 1)]
            made.append(Strip(100 * place + 10 + lane, *(_turned(b, degrees) for b in out), arm))
        for turn, way in TURNS.items():
            lane = 0 if turn == "left" else 1
            bounds = [_over(way, -LANE * (lane + side)) for side in (0, 1)]
            made.append(Strip(100 * place + 21 + way, *(_turned(b, degrees) for b in bounds), arm, turn))
    return made


def _over(way: int, y: float) -> FloatArray:
    """The line over the junction that begins at (-STOP, y) to the east, and turns by a quarter circle or not."""
    if way == 0:
        return np.array([[-STOP, y], [STOP, y]])
    angle = np.linspace(0.0, 0.5 * np.pi, 13)
    radius = STOP + way * -y if way > 0 else STOP + y
    return np.column_stack([-STOP + radius * np.sin(angle), y + way * radius * (1.0 - np.cos(angle))])


def write_map(path: Path) -> None:
    """Write the Lanelet2 file; the ``lanelet2`` package turns metres into degrees."""
    try:
        from lanelet2.core import BasicPoint3d
        from lanelet2.io import Origin
        from lanelet2.projection import UtmProjector
    except ModuleNotFoundError as error:
        raise not_installed("lanelet2") from error

    projector = UtmProjector(Origin(*ORIGIN))
    nodes: dict[tuple[float, float], int] = {}
    lines: list[str] = []
    ways: dict[tuple[int, ...], int] = {}

    def way(points: FloatArray, kind: str, subtype: str) -> int:
        keys = [(round(float(x), 3), round(float(y), 3)) for x, y in points]
        for key in keys:
            nodes.setdefault(key, 10_000 + len(nodes))
        refs = tuple(nodes[key] for key in keys)
        if refs not in ways:
            ways[refs] = 20_000 + len(ways)
            inner = "".join(f'<nd ref="{ref}"/>' for ref in refs)
            lines.append(f'<way id="{ways[refs]}">{inner}{_tags(type=kind, subtype=subtype)}</way>')
        return ways[refs]

    relations = []
    for arm, group in GROUPS.items():
        entries = [strip for strip in strips() if strip.arm == arm and strip.entry]
        stop = way(np.stack([entries[0].left[-1], entries[-1].right[-1]]), "stop_line", "solid")
        light = way(np.stack([entries[-1].right[-1], entries[-1].right[-1] + 0.5]), "traffic_light", "red_yellow_green")
        members = f'<member type="way" ref="{light}" role="refers"/><member type="way" ref="{stop}" role="ref_line"/>'
        tags = _tags(type="regulatory_element", subtype="traffic_light", name=group)
        relations.append(f'<relation id="{30_000 + int(group[1:])}">{members}{tags}</relation>')
    for strip in strips():
        inside = "virtual" if strip.turn else "line_thin"
        left, right = (way(bound, inside, "dashed") for bound in (strip.left, strip.right))
        members = f'<member type="way" ref="{left}" role="left"/><member type="way" ref="{right}" role="right"/>'
        if strip.entry:
            members += (
                f'<member type="relation" ref="{30_000 + int(GROUPS[strip.arm][1:])}" role="regulatory_element"/>'
            )
        tags = {"type": "lanelet", "subtype": "road", "location": "urban", "one_way": "yes", "speed_limit": "50 km/h"}
        if strip.turn:
            tags["turn_direction"] = strip.turn.replace("through", "straight")
        relations.append(f'<relation id="{strip.number}">{members}{_tags(**tags)}</relation>')
    placed = []
    for (x, y), number in nodes.items():
        point = projector.reverse(BasicPoint3d(x, y, 0.0))
        placed.append(f'<node id="{number}" lat="{point.lat:.10f}" lon="{point.lon:.10f}"/>')
    text = "\n".join(['<?xml version="1.0"?>', '<osm version="0.6">', *placed, *lines, *relations, "</osm>", ""])
    path.write_text(text, encoding="utf-8")


def _tags(**values: str) -> str:
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in values.items())


def shown(arm: str, time: float) -> int:
    """States of the signals of an arm."""
    left = time % CYCLE
    for seconds, who in PHASES:
        if left < seconds:
            return RED if arm[0] not in who.split(" ")[0] else AMBER if "amber" in who else GREEN
        left -= seconds
    raise AssertionError(time)


def states() -> pd.DataFrame:
    """A row for each change of a group: Signal, Time (of the recorders' clock, ms), Colour."""
    rows = []
    for arm, group in [*GROUPS.items(), ("", PEDESTRIANS)]:
        before = None
        for tick in range(-round(CYCLE * 10), round(SECONDS * 10)):
            now = shown(arm, tick / 10) if arm else (GREEN if shown("south", tick / 10) == GREEN else RED)
            if now != before:
                rows.append((group, CLOCK_MS + 100 * tick, now))
            before = now
    return pd.DataFrame(sorted(rows, key=lambda row: row[1]), columns=["Signal", "Time", "Colour"])


@dataclass
class Driver:
    """A vehicle on its way: `s` is the way of its middle from where its lane begins [m]."""

    number: int
    arm: str
    turn: str
    length: float
    width: float
    kind: str
    s: float
    speed: float
    decided: bool = False
    rows: list[tuple[float, ...]] = field(default_factory=list)

    @property
    def lane(self) -> tuple[str, bool]:
        return self.arm, self.turn == "left"


@dataclass(frozen=True)
class Ways:
    """The way of every arm and turn as a line of points, and where on it the stop line is and the junction ends."""

    points: dict[tuple[str, str], FloatArray]
    along: dict[tuple[str, str], FloatArray]
    out: dict[tuple[str, str], tuple[str, bool]]

    @classmethod
    def of(cls, made: Sequence[Strip]) -> Ways:
        points, along, out = {}, {}, {}
        order = list(ARMS)
        for strip in made:
            if not strip.turn:
                continue
            entry = next(s for s in made if s.entry and s.arm == strip.arm and _same(s.middle[-1], strip.middle[0]))
            leaving = next(s for s in made if not s.entry and not s.turn and _same(s.middle[0], strip.middle[-1]))
            way = np.concatenate([entry.middle, strip.middle[1:-1], leaving.middle])
            points[strip.arm, strip.turn] = way
            along[strip.arm, strip.turn] = np.r_[0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T))]
            out[strip.arm, strip.turn] = (leaving.arm, strip.turn == "left")
        assert len(points) == 3 * len(order)
        return cls(points, along, out)

    def pose(self, driver: Driver) -> tuple[float, float, float]:
        """Place of the middle [m] and heading [rad]: from the rear axle to the front one, as vehicles do."""
        way, s = self.points[driver.arm, driver.turn], self.along[driver.arm, driver.turn]
        half = 0.3 * driver.length
        front, rear = (
            np.array([np.interp(driver.s + side * half, s, way[:, axis]) for axis in (0, 1)]) for side in (1, -1)
        )
        middle, ahead = 0.5 * (front + rear), front - rear
        return float(middle[0]), float(middle[1]), float(np.arctan2(ahead[1], ahead[0]))

    def over(self, driver: Driver) -> float:
        """Length of the way over the junction [m]."""
        s = self.along[driver.arm, driver.turn]
        return float(s[-1]) - 2.0 * (ARM - STOP)


def _same(one: FloatArray, other: FloatArray) -> bool:
    return bool(np.hypot(*(one - other)) < 1e-6)


class Street:
    """Simulation of all vehicles that drive over the junction, step by step."""

    def __init__(self, seed: int) -> None:
        self.ways = Ways.of(strips())
        self.rng = np.random.default_rng(seed)
        self.drivers: list[Driver] = []
        self.count = 0
        self.next = {(arm, left): float(self.rng.exponential(4.0)) for arm in ARMS for left in (False, True)}

    def run(self) -> list[Driver]:
        """All vehicles seen, each with its rows: time [s], x, y [m], heading [rad], speed [m/s]."""
        done: list[Driver] = []
        for step in range(-round(WARM_UP / STEP), round(SECONDS / STEP) + 1):
            time = step * STEP
            self._enter(time + WARM_UP)
            wanted = [self._acceleration(driver, time) for driver in self.drivers]
            for driver, acceleration in zip(self.drivers, wanted, strict=True):
                before = driver.speed
                driver.speed = max(0.0, before + acceleration * STEP)
                driver.s += 0.5 * (before + driver.speed) * STEP
                x, y, yaw = self.ways.pose(driver)
                if step >= 0 and np.hypot(x, y) < SEEN:
                    driver.rows.append((time, x, y, yaw, driver.speed))
            gone = [driver for driver in self.drivers if driver.s > self.ways.along[driver.arm, driver.turn][-1] - 10.0]
            done += gone
            self.drivers = [driver for driver in self.drivers if driver not in gone]
        return [driver for driver in done + self.drivers if driver.rows]

    def _enter(self, time: float) -> None:
        for (arm, left), due in self.next.items():
            behind = min((d.s - 0.5 * d.length for d in self.drivers if d.lane == (arm, left)), default=ARM)
            if time < due or behind < 30.0:
                continue
            self.count += 1
            turn = "left" if left else str(self.rng.choice(["through", "right"], p=[0.75, 0.25]))
            kind = str(self.rng.choice(["Car", "Van", "Truck"], p=[0.8, 0.13, 0.07]))
            length = {"Car": 4.4, "Van": 5.2, "Truck": 8.6}[kind] + 0.1 * int(self.rng.integers(-3, 4))
            width = {"Car": 1.8, "Van": 2.0, "Truck": 2.5}[kind]
            speed = min(SPEED, 0.5 * max(0.0, behind - 10.0))
            self.drivers.append(Driver(self.count, arm, turn, length, width, kind, 6.0, speed))
            self.next[arm, left] = time + 2.0 + float(self.rng.exponential(28.0 if left else 9.0))

    def _acceleration(self, driver: Driver, time: float) -> float:
        """Acceleration by the intelligent driver model, behind the vehicle or stop line ahead."""
        line = ARM - STOP
        over = self.ways.over(driver)
        desired = SPEED
        inside = line - 25.0 < driver.s < line + over
        if inside and driver.turn != "through":  # slower as the bend comes nearer
            bend = 7.0 if driver.turn == "left" else 5.0
            desired = min(SPEED, np.sqrt(bend**2 + 2.0 * 1.8 * max(0.0, line - driver.s)))
        ahead = [self._leader(driver, line, over)]
        front = driver.s + 0.5 * driver.length
        if front < line and self._signal_stops(driver, line - front, time):
            ahead.append((line - 0.5 - front, 0.0))
        if driver.turn == "left" and line - 25.0 < front < line + WAIT and self._comes(driver, line, time):
            ahead.append((line + WAIT - front, 0.0))
        braking = 0.0
        for gap, speed in ahead:
            closing = driver.speed - speed
            wanted = GAP + max(
                0.0, HEADWAY * driver.speed + driver.speed * closing / (2.0 * np.sqrt(ACCELERATION * BRAKING))
            )
            braking = max(braking, (wanted / max(gap, 0.3)) ** 2)
        free = (driver.speed / desired) ** 4
        return float(np.clip(ACCELERATION * (1.0 - max(free, 0.0) - braking), -6.0, ACCELERATION))

    def _leader(self, driver: Driver, line: float, over: float) -> tuple[float, float]:
        """Gap [m] to the vehicle ahead on the lane, over the junction or on the lane after it, and its speed."""
        best = (np.inf, 0.0)
        for other in self.drivers:
            if other is driver:
                continue
            gap = np.inf
            if other.lane == driver.lane and other.s > driver.s:
                rear = other.s - 0.5 * other.length
                if other.turn == driver.turn or rear < line + 3.0:
                    gap = rear - driver.s
            elif self.ways.out[other.arm, other.turn] == self.ways.out[driver.arm, driver.turn]:
                beyond = other.s - line - self.ways.over(other)  # into the lane that both leave by
                own = driver.s - line - over
                if beyond > 0.0 and beyond > own:
                    gap = beyond - own - 0.5 * other.length
            gap -= 0.5 * driver.length
            if gap < best[0]:
                best = (gap, other.speed)
        return best

    @staticmethod
    def _signal_stops(driver: Driver, gap: float, time: float) -> bool:
        """Whether the driver, `gap` metres before its line, has to stop there for its signal, and can."""
        colour = shown(driver.arm, time)
        needs = driver.speed**2 / (2.0 * max(gap - 0.5, 0.1))
        return needs < 6.0 if colour == RED else colour == AMBER and needs < 3.0

    def _comes(self, driver: Driver, line: float, time: float) -> bool:
        """Whether an oncoming vehicle is too near for a left turn."""
        opposite = list(ARMS)[(list(ARMS).index(driver.arm) + 2) % len(ARMS)]
        oncoming = [other for other in self.drivers if other.arm == opposite and other.turn == "through"]
        return any(
            other.s < line + 22.0 + 0.5 * other.length
            and line - other.s < FREE * max(other.speed, 4.0)
            and (other.s > line or other.speed > 2.0 or shown(opposite, time) == GREEN)
            for other in oncoming
        )


def _walkers() -> Iterator[tuple[str, FloatArray]]:
    """Two pedestrians who cross an arm and a cyclist beside the road: class, and rows of time, x, y, heading, speed."""
    t = np.arange(0.0, 40.0, STEP)
    begin = 21.0  # when the south and north have green, so that no vehicle drives over the west and east arms
    for kind, x, y, degrees, speed in (
        ("Pedestrian", 20.0, -12.0, 90.0, 1.4),
        ("Pedestrian", -20.5, 12.0, -90.0, 1.2),
        ("Bicycle", -70.0, -11.0, 0.0, 4.0),
    ):
        way = speed * np.clip(t - begin, 0.0, 30.0)
        cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        place = _turned(np.column_stack([x + way * cos, y + way * sin]), ARMS["west"])
        same = np.full(len(t), np.deg2rad(degrees + ARMS["west"]))
        yield kind, np.column_stack([t, place, same, np.where(way > 0, speed, 0.0)])


def tracks(seed: int = 5) -> pd.DataFrame:
    """The raw table, in names and units of the recorders: 12.5 rows a second, centimetres, degrees from north."""
    drivers = sorted(Street(seed).run(), key=lambda driver: driver.rows[0][0])
    seen: list[tuple[str, float, float, FloatArray]] = [
        (driver.kind, driver.length, driver.width, np.array(driver.rows)) for driver in drivers
    ]
    seen += [(kind, 1.8 if kind == "Bicycle" else 0.5, 0.6, rows) for kind, rows in _walkers()]
    pieces = []
    for number, (kind, length, width, rows) in enumerate(seen, 1):
        place = _turned(rows[:, 1:3], TURN) + OFFSET
        values: dict[str, Any] = {
            "TrackID": number,
            "Class": kind,
            "Time_ms": CLOCK_MS + np.round(1000.0 * rows[:, 0]).astype(np.int64),
            "Easting": np.round(place[:, 0], 3),
            "Northing": np.round(place[:, 1], 3),
            "Course_deg": np.round(np.mod(90.0 - np.rad2deg(rows[:, 3]) - TURN, 360.0), 2),
            "Speed_kmh": np.round(3.6 * rows[:, 4], 2),
            "Length_cm": round(100 * length),
            "Width_cm": round(100 * width),
        }
        pieces.append(pd.DataFrame(values))
    return pd.concat(pieces).sort_values(["Time_ms", "TrackID"], ignore_index=True)


def write(folder: Path) -> None:
    """Write crossing.osm, tracks.csv and signals.csv."""
    folder.mkdir(parents=True, exist_ok=True)
    write_map(folder / "crossing.osm")
    tracks().to_csv(folder / "tracks.csv", index=False)
    states().to_csv(folder / "signals.csv", index=False)


@program
def main() -> None:
    """Write the files into a folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    write(parser.parse_args().folder)


if __name__ == "__main__":
    main()
