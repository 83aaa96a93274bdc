"""NGSIM's files as formats of recordings, plug-ins of ``litsim.recordings``."""

from __future__ import annotations

from pathlib import Path

from litsim_data.ngsim import formats, windows
from litsim_sim.io.parquet_input import is_parquet, read_schema
from litsim_sim.scenario.cropping import Crop
from litsim_sim.scenario.load import RecordingFormat
from litsim_sim.scenario.recording import Recording


class Official(RecordingFormat):
    """Official files of one site and period, which are cleaned as they are read."""

    content = "an official NGSIM file (text of 18 or 24 columns, or CSV with its header)"

    def recognizes(self, path: Path) -> bool:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        return path.suffix != ".parquet" and not is_parquet(path) and formats.detect(path) is not None

    def load(self, path: Path, crop: Crop | None) -> Recording:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        from litsim_data.ngsim import official  # loads scipy, which ready recordings do not need

        return official.load(path, crop)


class Windows(RecordingFormat):
    """The US-101 windows file of the development data."""

    content = f"the US-101 windows file (Parquet with columns {', '.join(windows.MARKERS)} among others)"

    def recognizes(self, path: Path) -> bool:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        return is_parquet(path) and windows.is_windows(read_schema(path).names)

    def load(self, path: Path, crop: Crop | None) -> Recording:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        return windows.load(path, crop)
