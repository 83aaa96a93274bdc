"""Segments: pieces of recordings to simulate, each with an ego, and the split of recordings into train, val and test.

A manifest lists the segments with the settings and recordings that they were cut from; equal inputs give equal
manifests. For simulation, recordings are split by time: no segment crosses a boundary between parts. For prediction,
vehicles are split by id, as in the protocol of conv-social-pooling.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, FloatArray, IntArray, Kind, is_obstacle
from litsim_sim.io.files import write_text
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import Recording

Part = Literal["train", "val", "test"]
PARTS: tuple[Part, ...] = ("train", "val", "test")
MANIFEST_FILE = "manifest.yaml"  # in a folder of segments
SHARES = (0.7, 0.1)  # of the vehicle ids for training and validation; the rest is for tests (conv-social-pooling)
ROUNDING = 1e-6  # since 0.7 + 0.1 is slightly less than 0.8
EGO_NOTE = "ego"  # note of a recording's header: id of the vehicle that is the ego wherever it can be
EGO_MOVES = 20.0  # [m] shortest way of an ego; excludes vehicles that only stand in a queue
EGO_KINDS = (Kind.CAR, Kind.TRUCK, Kind.UNKNOWN)


_Seconds = Annotated[float, Field(ge=STEP_S, allow_inf_nan=False)]  # at least a step, as in a scenario


class Settings(BaseModel):
    """How segments are cut.

    Attributes:
        seed: seed of the choice of egos.
        history_s: recorded past before the ego is free [s].
        simulation_s: simulated time after that [s].
        stride_s: time between the starts of successive segments [s]; below history_s + simulation_s they overlap.
        ego_min_s: shortest time after the history for which the ego is in the recording [s].
        split: shares of train, val and test.
        coverage_min: field of the scenarios, see :class:`litsim_sim.scenario.scenario_file.ScenarioFile`; None for its
            default.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    history_s: _Seconds = 3.0
    simulation_s: _Seconds = 25.0
    stride_s: _Seconds = 28.1
    ego_min_s: _Seconds = 10.0
    split: tuple[float, float, float] = (0.7, 0.1, 0.2)
    coverage_min: Annotated[float, Field(ge=0, le=1)] | None = None

    @property
    def steps(self) -> int:
        """Number of steps of a full segment; it has one frame more."""
        return self.history_steps + round(self.simulation_s / STEP_S)

    @property
    def history_steps(self) -> int:
        """Number of steps of the history of a segment."""
        return round(self.history_s / STEP_S)

    @property
    def needed_steps(self) -> int:
        """Number of steps from the start of a segment for which its ego must be in the recording."""
        return self.history_steps + round(self.ego_min_s / STEP_S)


class Source(BaseModel):
    """A recording in a manifest.

    Attributes:
        file: path, relative to the manifest's folder unless absolute; may begin with ``$LITSIM_DATA``.
        crop: the [low, high] that was kept, by column of the file.
        digest: see :func:`content_digest`.
        net: name of a packaged net, or a path relative to the manifest's folder.
        frames: first and last frame.
        vehicles: largest ids of train and of val, see :func:`last_ids`; larger ids are test.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str
    crop: dict[str, list[float]] | None = None
    digest: str
    net: str
    frames: tuple[int, int]
    vehicles: tuple[int, int]


class Segment(BaseModel):
    """A piece of a recording.

    Attributes:
        name: unique name, also that of the scenario file.
        recording: index in the manifest's `recordings`.
        part: part of the split by time.
        frames: first and last frame.
        shortened: whether the recording or its part is too short for a full segment.
        ego: id of the vehicle that the system under test drives.
        egos: ids of all vehicles that can be the ego, `ego` first.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    recording: int
    part: Part
    frames: tuple[int, int]
    shortened: bool
    ego: int
    egos: list[int]


class Manifest(BaseModel):
    """A set of segments, with their settings and recordings; `without_ego` counts the pieces that no vehicle fits."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    litsim_segments: Literal[1] = 1
    settings: Settings
    recordings: list[Source]
    segments: list[Segment]
    without_ego: int = 0

    def to_yaml(self) -> str:
        """Returns the manifest as the text of a YAML file."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=120)

    @classmethod
    def read(cls, path: Path) -> Manifest:
        """Reads a manifest.

        Raises:
            InputError: the file is missing or not a manifest.
        """
        return read_yaml(path, cls)


def name_of(file: str, part: str, count: int) -> str:
    """Returns the name of segment number `count` of a `part` of the recording in `file`."""
    return f"{Path(file).name.split('.')[0]}_{part}_{count:02d}"


def cut(
    recordings: Sequence[tuple[str, str, dict[str, list[float]] | None, Recording]], settings: Settings
) -> Manifest:
    """Cuts recordings into segments; of each are given file name and net for the manifest, crop, and content.

    Raises:
        InputError: there is nothing to cut, or the shares of the split are no shares.
    """
    if not (min(settings.split) >= 0 and abs(sum(settings.split) - 1.0) <= 1e-6):  # neither holds of nan
        raise InputError(f"the split is {settings.split}, expected three shares that add up to 1")
    if settings.ego_min_s > settings.simulation_s:
        raise InputError(
            f"ego_min_s is {settings.ego_min_s:g}, expected at most simulation_s, which is {settings.simulation_s:g}: "
            f"no ego is there for longer than its segment"
        )
    sources = [_source(*recording) for recording in recordings]
    segments: list[Segment] = []
    without_ego = 0
    for number, (source, (*_, recording)) in enumerate(zip(sources, recordings, strict=True)):
        rng = np.random.default_rng([settings.seed, number])
        tracks = _Tracks(recording)
        counts: Counter[str] = Counter()
        for part, start, end in _windows(*source.frames, settings):
            egos = tracks.egos(start, end, settings)
            if not len(egos):
                without_ego += 1
                continue
            drawn, recorder = int(rng.choice(egos)), recording.header.notes.get(EGO_NOTE)
            ego = recorder if isinstance(recorder, int) and recorder in egos else drawn
            segments.append(
                Segment(
                    name=name_of(source.file, part, counts[part]),
                    recording=number,
                    part=part,
                    frames=(start, end),
                    shortened=end - start < settings.steps,
                    ego=ego,
                    egos=[ego, *(int(other) for other in egos if other != ego)],
                )
            )
            counts[part] += 1
    names = [segment.name for segment in segments]
    if not segments:
        raise InputError(
            f"no segment found: expected recordings with {settings.needed_steps * STEP_S:g} s or more in some part of "
            f"the split {settings.split}, and a vehicle that is there so long and travels {EGO_MOVES:g} m; "
            f"{without_ego} pieces had no such vehicle"
        )
    if len(set(names)) < len(names):
        raise InputError("two recordings have the same file name, which would give segments the same name: rename one")
    return Manifest(settings=settings, recordings=sources, segments=segments, without_ego=without_ego)


def _source(file: str, net: str, crop: dict[str, list[float]] | None, recording: Recording) -> Source:
    """Returns the manifest's entry of a recording."""
    frames, vehicles = recording.columns["frame"], ~is_obstacle(recording.columns["kind"])
    ids = last_ids(recording.columns["vehicle_id"][vehicles])
    span = int(frames.min()), int(frames.max())
    return Source(file=file, crop=crop, digest=content_digest(recording), net=net, frames=span, vehicles=ids)


def reproduce(manifest: Manifest, folder: Path) -> tuple[Manifest, list[Recording]]:
    """Cuts the recordings of `manifest`, which lies in `folder`, again.

    Returns:
        The new manifest, and its recordings, cropped.

    Raises:
        InputError: a recording is missing, or its content has changed.
    """
    sources = []
    for source in manifest.recordings:
        path = folder / os.path.expandvars(source.file)
        recording = load_recording(path, source.crop)
        if content_digest(recording) != source.digest:
            raise InputError(f"{path}: not the recording that the manifest names: the digest of its content differs")
        sources.append((source.file, source.net, source.crop, recording))
    return cut(sources, manifest.settings), [recording for *_, recording in sources]


def content_digest(recording: Recording) -> str:
    """Returns the SHA-256 over the columns of a recording, independent of the file's format and compression."""
    digest = hashlib.sha256(b"litsim-recording-1\n")
    for name, values in recording.table.items():
        array = values.to_numpy()
        digest.update(f"{name} {array.dtype.str} {len(array)}\n".encode())
        digest.update(np.ascontiguousarray(array.astype(array.dtype.newbyteorder("<"), copy=False)).tobytes())
    return digest.hexdigest()


def scenario_yaml(manifest: Manifest, segment: Segment) -> str:
    """Returns the text of a scenario file for `segment`, to be put into the manifest's folder."""
    source, settings = manifest.recordings[segment.recording], manifest.settings
    first, last = segment.frames
    marks = ", shortened" if segment.shortened else ""
    fields: dict[str, object] = {
        "name": segment.name,
        "description": f"Frames {first} to {last} of {Path(source.file).name}, part {segment.part}{marks}.",
        "recording": source.file,
        "crop": source.crop,
        "net": source.net,
        "start_frame": first,
        "history_s": settings.history_s,
        "simulation_s": round((last - first) * STEP_S - settings.history_s, 6),
        "seed": settings.seed,
        "ego": segment.ego,
        "egos": segment.egos,
        "coverage_min": settings.coverage_min,
    }
    fields = {name: value for name, value in fields.items() if value is not None}
    return yaml.safe_dump(fields, sort_keys=False, default_flow_style=None, width=120)


def write(manifest: Manifest, folder: Path) -> Path:
    """Writes :data:`MANIFEST_FILE` and a scenario file for every segment; returns the manifest's path.

    Raises:
        InputError: `folder` cannot be written.
    """
    for segment in manifest.segments:
        write_text(folder / f"{segment.name}.yaml", scenario_yaml(manifest, segment))
    write_text(folder / MANIFEST_FILE, manifest.to_yaml())
    return folder / MANIFEST_FILE


def describe(manifest: Manifest) -> str:
    """Returns the number of segments by part, and that of recordings, as lines of text."""
    lines = []
    for part in PARTS:
        of_part = [segment for segment in manifest.segments if segment.part == part]
        short = sum(segment.shortened for segment in of_part)
        lines.append(f"{part:<6}{len(of_part)} segments" + (f", {short} shortened" if short else ""))
    lines.append(f"{len(manifest.segments)} segments of {len(manifest.recordings)} recordings")
    if manifest.without_ego:
        lines.append(f"{manifest.without_ego} pieces were left out: no vehicle in them can be the ego")
    return "\n".join(lines)


def last_ids(vehicle: IntArray) -> tuple[int, int]:
    """Returns the largest ids of train and of val in the split by id: 70/10/20 % of the ids in `vehicle`, rounded down.

    Ids of a recording ascend with time, so that the parts follow each other and hardly overlap in time (as in
    conv-social-pooling).
    """
    ids = np.unique(vehicle)
    before = [ids[0] - 1 if len(ids) else 0, *ids]  # the largest id of no vehicles, of one, of two, ...
    train, val = (int(before[int(share * len(ids) + ROUNDING)]) for share in np.cumsum(SHARES))
    return train, val


def parts_of(vehicle: IntArray) -> IntArray:
    """Returns the part (R,) of each id in `vehicle` (R,), as an index in :data:`PARTS`; see :func:`last_ids`."""
    return np.searchsorted(last_ids(vehicle), vehicle)


def _windows(first: int, last: int, settings: Settings) -> list[tuple[Part, int, int]]:
    """Returns the part, first and last frame of every segment of a recording from frame `first` to `last`."""
    frames, stride = last - first + 1, max(round(settings.stride_s / STEP_S), 1)
    bounds = [first + round(share * frames) for share in (0.0, *np.cumsum(settings.split))]
    windows: list[tuple[Part, int, int]] = []
    for part, begin, end in zip(PARTS, bounds[:-1], bounds[1:], strict=True):
        length = min(settings.steps, end - begin - 1)  # a part shorter than a segment is one segment
        if length >= settings.needed_steps:
            windows += [(part, start, start + length) for start in range(begin, end - length, stride)]
    return windows


class _Tracks:
    """The tracks of the vehicles of a recording."""

    def __init__(self, recording: Recording) -> None:
        table = recording.table[["vehicle_id", "frame", "x", "y", "kind"]].sort_values(["vehicle_id", "frame"])
        self._ids, self._row, count = np.unique(table["vehicle_id"].to_numpy(), return_index=True, return_counts=True)
        self._first = table["frame"].to_numpy()[self._row]
        self._last = self._first + count - 1  # recordings have no holes
        self._kind = table["kind"].to_numpy()[self._row]
        self._way: FloatArray = np.cumsum(np.hypot(*(np.diff(table[axis], prepend=0.0) for axis in ("x", "y"))))

    def egos(self, start: int, end: int, settings: Settings) -> np.ndarray:
        """Returns ids (k,) of the vehicles that can be the ego of the segment from frame `start` to `end`."""
        last = np.minimum(self._last, end)
        fits = (self._first <= start) & (last >= start + settings.needed_steps) & np.isin(self._kind, EGO_KINDS)
        rows = np.flatnonzero(fits)
        begin, until = self._row[rows] + start - self._first[rows], self._row[rows] + last[rows] - self._first[rows]
        return cast(np.ndarray, self._ids[rows[self._way[until] - self._way[begin] >= EGO_MOVES]])
