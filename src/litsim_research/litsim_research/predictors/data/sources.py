"""Sources of traffic for training and tests: recordings in the neutral schema, and the development data as published.

Each reader returns :class:`Tracks` by part. The rows of one part are in no other, neither as targets nor as traffic
around them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field

from litsim_data.ngsim import windows as ngsim_windows
from litsim_data.segments import PARTS, Part, parts_of
from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.data.us101_road import Us101Road
from litsim_research.predictors.data.us101_tracks import LEADER_SIZE, US101_NET, apart_from, with_leaders
from litsim_sim.io.parquet_input import read_table
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.recorded_net import net_of
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.signals import Signals, SignalsFile, signals_of

PERIOD_IDS, PERIOD_FRAMES = 100_000, 100_000  # offsets of ids and frames from one period of a site to the next


class _Source(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    share: Annotated[float, Field(gt=0, le=1000)] = 1.0


class RecordingSource(_Source):
    """Recordings in the neutral schema, each split 70/10/20 by vehicle id, or whole for one part.

    With `signals`, the stop lines that those of the recordings close are among the vehicles.
    """

    kind: Literal["recording"]
    files: tuple[str, ...]
    part: Part | None = None
    signals: bool = False


class Us101WindowSource(_Source):
    """The windows of the US-101 development file.

    Rows in `test_frames` (first, last) are for tests, and vehicles that have none there are for `part`.
    """

    kind: Literal["us101_windows"]
    file: str
    test_frames: tuple[int, int]
    part: Literal["train", "val"] = "train"


class Us101TrackSource(_Source):
    """Single US-101 vehicles and the leaders given by their headways, without the vehicles of the test windows.

    Rows in `untrained_frames` (first, last) of the first period are not for training, such as those of windows that are
    for validation.
    """

    kind: Literal["us101_tracks"]
    file: str
    windows: str
    test_frames: tuple[int, int]
    untrained_frames: tuple[int, int] | None = None


class I80LaneSource(_Source):
    """All I-80 vehicles by lane, with positions along it only."""

    kind: Literal["i80_lanes"]
    file: str


class I80PairSource(_Source):
    """I-80 followers and leaders along their lanes; a tenth of the pairs, by number, is for validation.

    Pairs that share a vehicle with one of these are left out.
    """

    kind: Literal["i80_pairs"]
    file: str


Source = Annotated[
    RecordingSource | Us101WindowSource | Us101TrackSource | I80LaneSource | I80PairSource,
    Field(discriminator="kind"),
]


def load(source: Source, locate: Callable[[str], Path]) -> dict[Part, list[Tracks]]:
    """Returns the tracks of a source by part; `locate` finds files by their names in configurations.

    Raises:
        InputError: a file is missing, or its content does not fit the kind of the source.
    """
    readers: dict[str, Callable[[Any, Callable[[str], Path]], dict[Part, list[Tracks]]]] = {
        "recording": _recordings,
        "us101_windows": _us101_windows,
        "us101_tracks": _us101_tracks,
        "i80_lanes": _i80_lanes,
        "i80_pairs": _i80_pairs,
    }
    return readers[source.kind](source, locate)


def files_of(source: Source) -> tuple[str, ...]:
    """Returns the files that a source reads, as its configuration names them."""
    if isinstance(source, RecordingSource):
        return source.files
    return (source.file, source.windows) if isinstance(source, Us101TrackSource) else (source.file,)


def digest_of(path: Path) -> str:
    """Returns the SHA-256 of the file at `path`, as hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def signals_of_recording(recording: Recording, net: Path | None) -> Signals | None:
    """Returns the signals that a recording on `net` carries, from frame 0 to its last; None without any."""
    if net is None or not recording.header.signals:
        return None
    frames = int(recording.table["frame"].max()) + 1
    return signals_of(SignalsFile.model_validate(recording.header.signals), read_links(net), frames)


def split(tracks: Tracks) -> dict[Part, list[Tracks]]:
    """Returns the tracks, split by vehicle id: 70 % train, 10 % val, 20 % test; empty parts are left out.

    Closed stop lines are in every part.
    """
    vehicles, part = ~tracks.is_line, np.full(len(tracks), -1)
    part[vehicles] = parts_of(tracks.vehicle[vehicles])
    return {name: [tracks.take((part == k) | ~vehicles)] for k, name in enumerate(PARTS) if (part == k).any()}


def _recordings(source: RecordingSource, locate: Callable[[str], Path]) -> dict[Part, list[Tracks]]:
    parts: dict[Part, list[Tracks]] = {}
    for file in source.files:
        path = locate(file)
        recording = Recording.read(path)
        net = net_of(recording.header, path) if recording.header.net else None
        signals = signals_of_recording(recording, net) if source.signals else None
        tracks = Tracks.from_table(recording.header.name, recording.table, net, signals=signals)
        for name, pieces in (split(tracks) if source.part is None else {source.part: [tracks]}).items():
            parts.setdefault(name, []).extend(pieces)
    return parts


def _us101_windows(source: Us101WindowSource, locate: Callable[[str], Path]) -> dict[Part, list[Tracks]]:
    table = ngsim_windows.read_table(locate(source.file))
    tracks = Tracks.from_table("us101_windows", table, US101_NET)
    first, last = source.test_frames
    test = (tracks.frame >= first) & (tracks.frame <= last)
    other = ~np.isin(tracks.vehicle, np.unique(tracks.vehicle[test]))
    return {source.part: [tracks.take(other)], "test": [tracks.take(test)]}


def _us101_tracks(source: Us101TrackSource, locate: Callable[[str], Path]) -> dict[Part, list[Tracks]]:
    columns = ("period", "vehicle_id", "frame", "local_x_m", "local_y_m", "speed_mps", "space_headway_m")
    path = locate(source.windows)
    windows = read_table(path, ngsim_windows.COLUMNS)
    road = Us101Road.fit(windows, str(path))
    table = read_table(locate(source.file), columns)
    table = table[table["local_y_m"] <= road.end].sort_values(["period", "vehicle_id", "frame"])
    table = table[apart_from(table, ngsim_windows.neutral_table(windows, str(path)), source.test_frames, road)]
    table = table.astype({"vehicle_id": np.int64, "frame": np.int64, "period": np.int64})
    table["vehicle_id"] += PERIOD_IDS * table["period"]
    table["frame"] += PERIOD_FRAMES * table["period"]
    # Few vehicles have full tracks, and tests are on the windows: the test part of the split is for training as well.
    val = parts_of(table["vehicle_id"].to_numpy(np.int64)) == PARTS.index("val")
    train = ~val
    if source.untrained_frames is not None:
        train &= ~table["frame"].between(*source.untrained_frames).to_numpy()  # frames of other periods are larger
    return {"train": [with_leaders(table[train], road)], "val": [with_leaders(table[val], road)]}


def _i80_lanes(source: I80LaneSource, locate: Callable[[str], Path]) -> dict[Part, list[Tracks]]:
    table = read_table(locate(source.file), ("period", "lane", "vehicle_id", "frame", "local_y_m", "speed_mps"))
    table = table.rename(columns={"local_y_m": "front", "speed_mps": "speed"}).assign(length=np.float32(LEADER_SIZE[0]))
    parts: dict[Part, list[Tracks]] = {"train": [], "val": []}
    for tracks in _along_lanes(table):
        val = parts_of(tracks.vehicle) == PARTS.index("val")
        parts["train"].append(tracks.take(~val))
        parts["val"].append(tracks.take(val))
    return parts


def _i80_pairs(source: I80PairSource, locate: Callable[[str], Path]) -> dict[Part, list[Tracks]]:
    common, values = ["period", "pair", "lane", "frame"], {"y_m": "front", "speed_mps": "speed", "length_m": "length"}
    of = {
        who: {who: "vehicle_id"} | {f"{who}_{name}": column for name, column in values.items()}
        for who in ("follower", "leader")
    }
    del of["follower"]["follower_length_m"]  # there is no such column
    table = read_table(locate(source.file), (*common, *of["follower"], *of["leader"]))
    rows = pd.concat([table[[*common, *names]].rename(columns=names) for names in of.values()], ignore_index=True)
    vehicle = ["period", "vehicle_id"]
    rows["length"] = rows.groupby(vehicle)["length"].transform("first").fillna(LEADER_SIZE[0])

    val = parts_of(rows["pair"].to_numpy(np.int64)) == PARTS.index("val")
    key = pd.MultiIndex.from_frame(rows[vehicle])
    shared = rows["pair"].isin(rows["pair"][key.isin(key[val])])
    return {"train": _along_lanes(rows[~shared]), "val": _along_lanes(rows[val])}


def _along_lanes(table: pd.DataFrame) -> list[Tracks]:
    """Returns tracks of I-80 vehicles by period and lane, each lane as a straight road of its own.

    `table` has columns period, lane, vehicle_id, frame, front [m] along the lane, speed [m/s] and length [m].
    """
    lanes = []
    for (period, lane), rows in table.groupby(["period", "lane"]):
        straight = rows.drop_duplicates(["vehicle_id", "frame"]).assign(y=0.0, yaw=0.0, width=LEADER_SIZE[1])
        straight["x"] = straight["front"] - 0.5 * straight["length"]
        lanes.append(Tracks.from_table(f"i80_{period}_lane{lane}", straight, None))
    return lanes
