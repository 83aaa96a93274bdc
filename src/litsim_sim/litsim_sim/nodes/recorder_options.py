"""The parameters of the recorder."""

from __future__ import annotations

from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.quantities import Flag, configuration


@configuration
class RecorderOptions:
    """Where and what of a run is recorded.

    Attributes:
        output: folder of the recording.
        overwrite: whether an existing recording is replaced.
        topics: names of topics of the ego's stack to be recorded as well, separated by spaces.
    """

    output: str = "bags/run"
    overwrite: Flag = False
    topics: str = ""


def recorder_stage(read: ParameterOverrides) -> RecorderOptions:
    """Read the parameters of the recorder."""
    return read(RecorderOptions())
