"""The encounters of the published data: a table that is part of this package, and scenarios built from the data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from importlib import resources
from pathlib import Path

from litsim_data.encounters import straight_road
from litsim_data.encounters.encounter import Encounter
from litsim_data.encounters.following import LANES, PAIRS, VEHICLES, FollowingTrack, lanes, pairs, vehicles
from litsim_data.encounters.in_traffic import Traffic
from litsim_data.encounters.lack import Lack
from litsim_data.encounters.leader_brakes import AFTER, brakings
from litsim_data.encounters.origin import Origin
from litsim_data.encounters.table import TABLE, EncounterRow, table_rows
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.encounter_note import Split
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.scenario import packaged

WINDOWS = "ngsim/us101_0750_frames_0126_1149.parquet"
WINDOW = {"frame": [316.0, 543.0], "local_y_m": [180.0, 415.0]}
"""The window of the packaged scenario us101_0750; the others of that file are too short for encounters."""
FOLLOWING: dict[str, Callable[[Path], Iterator[FollowingTrack]]] = {PAIRS: pairs, LANES: lanes, VEHICLES: vehicles}
"""Functions that read the recorded car following in each source."""


def rows(split: Split | None = None) -> tuple[EncounterRow, ...]:
    """Returns the rows of the packaged table, of one `split` or of both."""
    return tuple(row for row in _all_rows() if split is None or row.split == split)


def build(wanted: Iterable[EncounterRow], data: Path) -> Iterator[Encounter]:
    """Yields the encounters of the rows `wanted` from the files below `data`, in the order of the table.

    Raises:
        InputError: a file is missing, or does not have an encounter.
    """
    left = {row.name: row for row in wanted}
    for source, encounters in SOURCES.items():
        own = [row for row in left.values() if row.source == source]
        if own:
            for _, encounter in encounters(source, data, own, Counter()):
                del left[encounter.name]
                yield encounter
    for name, row in left.items():
        raise InputError(f"{data / row.source}: has no encounter {name}: is it the file that the table was made from?")


def made_anew(data: Path, left_out: Counter[Lack]) -> Iterator[EncounterRow]:
    """Yields the rows of all encounters in the files below `data`; counts in `left_out` what other moments lack.

    Of an agent that two files have at a time, the encounter in the first counts.

    Raises:
        InputError: a file is missing, or lacks a column.
    """
    onsets: dict[tuple[str, int, int], list[int]] = {}  # frames by agent
    for source, encounters in SOURCES.items():
        for period, encounter in encounters(source, data, None, left_out):
            row = EncounterRow.of(encounter, source, period)
            of_agent = onsets.setdefault((row.site, row.period, row.agent), [])
            if all(abs(row.onset_frame - frame) >= AFTER for frame in of_agent):
                of_agent.append(row.onset_frame)
                yield row


def _of_following(
    source: str, data: Path, wanted: Sequence[EncounterRow] | None, left_out: Counter[Lack]
) -> Iterator[tuple[int, Encounter]]:
    """Yields period and content of the encounters in recorded car following, all or those `wanted`."""
    names = None if wanted is None else {row.name for row in wanted}
    agents = None if wanted is None else {(row.period, row.agent) for row in wanted}
    for track in FOLLOWING[source](data):
        if agents is not None and (track.period, track.follower) not in agents:
            continue
        for braking in brakings(track):
            if braking.lack:
                left_out[braking.lack] += 1
            elif names is None or braking.name in names:
                yield track.period, straight_road.encounter(braking)


def _of_window(
    source: str, data: Path, wanted: Sequence[EncounterRow] | None, left_out: Counter[Lack]
) -> Iterator[tuple[int, Encounter]]:
    """Yields period and content of the encounters in the US-101 window, all or those `wanted`."""
    names = None if wanted is None else {row.name for row in wanted}
    recording, net = load_recording(data / source, WINDOW), packaged("nets/us101.net.xml")
    origin = Origin(recording.header.source, recording.header.licence, net, LaneMap.from_net(net))
    traffic = Traffic(recording, origin, "us101", left_out=left_out)
    for block in traffic.blocks:
        for encounter in traffic.encounters(block):
            if names is None or encounter.name in names:
                yield traffic.period, encounter


SOURCES = {**dict.fromkeys(FOLLOWING, _of_following), WINDOWS: _of_window}
"""Functions that yield the encounters of each file."""


@cache
def _all_rows() -> tuple[EncounterRow, ...]:
    return table_rows(resources.files("litsim_data.encounters").joinpath(TABLE).read_text(encoding="utf-8"))
