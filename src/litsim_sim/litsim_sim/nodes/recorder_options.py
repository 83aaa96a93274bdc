"""The parameters of the recorder."""

from __future__ import annotations

from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.quantities import Flag, configuration


@configuration
class RecorderOptions:
    """Where a run is recorded.

    Attributes:
        output: folder of the recording.
        overwrite: whether an existing recording is replaced.
    """

    output: str = "bags/run"
    overwrite: Flag = False


def recorder_stage(read: ParameterReader) -> RecorderOptions:
    """Read the parameters of the recorder."""
    return read(RecorderOptions())
