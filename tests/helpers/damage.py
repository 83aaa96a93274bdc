"""Deliberate damage to files, and checks that readers notice it."""

from __future__ import annotations

import json
import random
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.core.errors import InputError
from litsim_sim.record.digest import RunDigest
from litsim_sim.record.run import Run, read_run

BLOCK = 512  # [bytes] sector of a disk
SAME, REFUSED, SHORTER = "same measures", "refused", "reported as cut short"
Counts = Counter[tuple[str, str]]
"""How often a way of damage gave SAME, REFUSED or SHORTER."""


def _flip(data: bytearray, at: int, random_: random.Random) -> None:
    data[at] ^= 1 << random_.randrange(8)


def _replace(data: bytearray, at: int, random_: random.Random) -> None:
    data[at] = random_.choice([0, 255, random_.randrange(256)])


def _remove(data: bytearray, at: int, random_: random.Random) -> None:
    del data[at : at + random_.choice([1, 1, random_.randrange(1, BLOCK)])]


def _insert(data: bytearray, at: int, random_: random.Random) -> None:
    data[at:at] = random_.randbytes(random_.choice([1, 1, random_.randrange(1, BLOCK)]))


def _zero(data: bytearray, at: int, _: random.Random) -> None:
    end = min(at + BLOCK, len(data))
    data[at:end] = bytes(end - at)


def _repeat(data: bytearray, at: int, random_: random.Random) -> None:
    data[at : at + BLOCK] = data[(other := random_.randrange(len(data))) : other + BLOCK]


CUT, FLIP = "truncated", "a bit flipped"
WAYS: dict[str, Callable[[bytearray, int, random.Random], None]] = {
    FLIP: _flip,
    "a byte replaced": _replace,
    "bytes removed": _remove,
    "bytes inserted": _insert,
    f"{BLOCK} bytes zeroed": _zero,
    f"{BLOCK} bytes taken from elsewhere": _repeat,
}
"""What is done to a file from a byte on."""


def damages(data: bytes, tries: int, seed: int, *, cuts: float = 0.01) -> Iterator[tuple[str, bytes]]:
    """Damaged versions of `data`, none equal to it, each with the name of what was done.

    Args:
        data: content of a file.
        tries: number of versions; half of them have one bit flipped, at places spread evenly.
        seed: seed of all random choices.
        cuts: share of versions that are truncated.
    """
    draw = random.Random(seed)
    others = list(WAYS)[1:]
    for number in range(tries):
        at = number * len(data) // tries if number % 2 else draw.randrange(len(data))
        if draw.random() < cuts:
            yield CUT, data[:at]
            continue
        way = FLIP if number % 2 else draw.choice(others)
        damaged = bytearray(data)
        WAYS[way](damaged, at, draw)
        if damaged != data and not data.startswith(damaged):
            yield way, bytes(damaged)


def outcomes(
    path: Path, versions: Iterator[tuple[str, bytes]], read: Callable[[Path], Any], shorter: Callable[[Any], bool]
) -> Counts:
    """Write each version to `path` and read it; raises AssertionError for a result that must not occur.

    Args:
        path: the file, which holds the undamaged content.
        versions: versions of its content from :func:`damages`.
        read: reads it; gives equal results for equal content.
        shorter: whether a result is, as it says itself, a part of the undamaged one.
    """
    whole, found = read(path), Counter[tuple[str, str]]()
    for way, data in versions:
        path.write_bytes(data)
        try:
            got = read(path)
        except InputError as error:
            said = str(error)
        else:
            said = ""
        if said:
            assert str(path) in said and "\n" not in said, f"{way}: {said}"
            found[way, REFUSED] += 1
            continue
        if got == whole:
            found[way, SAME] += 1
        else:
            assert shorter(got), f"{way}: read as something else"
            found[way, SHORTER] += 1
    return found


class Measured:
    """A record as it is analysed: its run, and its measures but for times on the clock."""

    def __init__(self, path: Path) -> None:
        self.run: Run = read_run(path)
        self.metrics = json.dumps({**compute_metrics(self.run), "timing": None}, allow_nan=False)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Measured) and self.metrics == other.metrics

    def __hash__(self) -> int:
        return hash(self.metrics)

    def is_part_of(self, whole: Measured) -> bool:
        """Whether it is not valid, says that it is cut short, and holds what the whole run begins with."""
        said = json.loads(self.metrics)
        return (
            not self.run.complete
            and not said["valid"]
            and "the recording is cut short at byte" in said["why"]
            and said["digest"] == _digest(whole.run, self.run)
        )


def _digest(whole: Run, part: Run) -> str:
    """The digest of as much of `whole` as `part` holds."""
    total = RunDigest()
    for table in whole.tables[: len(part.tables)]:
        controls = whole.controls.get(table.step) if table.step in part.controls else None
        total.update(table, controls, whole.ego_commands.get(table.step) if table.step in part.ego_commands else None)
    return total.hexdigest()


def damage_record(path: Path, tries: int, seed: int) -> Counts:
    """Damage the record at `path`, an MCAP file, and measure it; what was there is not put back."""
    whole, data = Measured(path), path.read_bytes()
    return outcomes(path, damages(data, tries, seed), Measured, lambda part: part.is_part_of(whole))
