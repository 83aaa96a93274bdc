"""The format `tracks_json`: a JSON object whose field `tracks` has rows of id, frame, x, y, yaw and speed."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Kind
from litsim_sim.scenario.cropping import Crop
from litsim_sim.scenario.load import RecordingFormat
from litsim_sim.scenario.recording import Recording, RecordingHeader

COLUMNS = ["vehicle_id", "frame", "x", "y", "yaw", "speed"]  # [-], [0.1 s], [m], [m], [rad], [m/s], box centres


class TracksJson(RecordingFormat):
    """Tracks at 10 Hz of cars of one size."""

    content = 'JSON with a field "tracks"'

    def recognizes(self, path: Path) -> bool:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        with path.open("rb") as file:
            return file.read(100).lstrip().startswith(b'{"tracks"')

    def load(self, path: Path, crop: Crop | None) -> Recording:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        if crop:
            raise InputError(f"{path}: this format cannot be cropped")
        table = pd.DataFrame(json.loads(path.read_text(encoding="utf-8"))["tracks"], columns=COLUMNS)
        table = table.assign(acceleration=0.0, length=4.6, width=1.9, kind=int(Kind.CAR), lane=-1)
        header = RecordingHeader(path.stem, source="tracks_json", licence="unknown", net="us101_like.net.xml")
        return Recording.from_table(header, table, str(path))
