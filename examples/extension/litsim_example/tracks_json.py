"""The format `tracks_json`: a JSON object whose field `tracks` has rows of id, frame, x, y, yaw and speed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.sources.source import Scene, Source

COLUMNS = ["vehicle_id", "frame", "x", "y", "yaw", "speed"]  # [-], [0.1 s], [m], [m], [rad], [m/s], box centres


class TracksJson(Source):
    """Tracks at 10 Hz of cars of one size."""

    content, licence, citation = 'JSON with a field "tracks"', "unknown", "tracks_json"

    def recognizes(self, path: Path) -> bool:
        """See :class:`litsim_data.sources.source.Source`."""
        with path.open("rb") as file:
            return file.read(100).lstrip().startswith(b'{"tracks"')

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:  # noqa: ARG002 - the tracks have no map
        """See :class:`litsim_data.sources.source.Source`."""
        rows = pd.DataFrame(json.loads(path.read_text(encoding="utf-8"))["tracks"], columns=COLUMNS)
        tracks = LoadedTable.of(path, dict(rows.assign(length=4.6, width=1.9, kind="car")))
        yield Scene(path.stem, tracks, tracks.meaning({"car": "car"}, net="us101_like.net.xml"))
