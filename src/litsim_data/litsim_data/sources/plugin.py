"""Tracks of all data sets as a format of recordings, a plug-in of ``litsim.recordings``: without map and signals."""

from __future__ import annotations

from pathlib import Path

from litsim_data.sources.source import source_of
from litsim_sim.scenario.cropping import Crop, within
from litsim_sim.scenario.load import RecordingFormat
from litsim_sim.scenario.recording import Recording


class Tracks(RecordingFormat):
    """The first scene of a file that `data import` reads."""

    content = "a data set that `data import` reads"

    def recognizes(self, path: Path) -> bool:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        return source_of(path) is not None

    def load(self, path: Path, crop: Crop | None) -> Recording:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        from litsim_data.sources.importing import converted  # loads scipy, which ready recordings do not need

        source = source_of(path)
        assert source is not None  # `recognizes` has said so
        scene = next(source.read(path, None))
        recording, _ = converted(scene, source)
        if not crop:
            return recording
        rows = within(recording.columns, len(recording.columns["frame"]), crop, str(path))
        return recording.take(rows)
