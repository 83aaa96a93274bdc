"""ROS 2 bags of Autoware as a format of recordings, a plug-in of ``litsim.recordings``."""

from __future__ import annotations

from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import read_head
from litsim_sim.scenario.cropping import Crop
from litsim_sim.scenario.load import RecordingFormat
from litsim_sim.scenario.recording import Recording

MAGIC = (b"\x89MCAP0\r\n", b"SQLite format 3\0")
METADATA_FILE, METADATA_FIELD = "metadata.yaml", b"rosbag2_bagfile_information"


class AutowareBag(RecordingFormat):
    """Bags with Autoware's objects and the ego's odometry."""

    content = "a ROS 2 bag of Autoware (.mcap, .db3, or metadata.yaml of its folder)"

    def recognizes(self, path: Path) -> bool:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        return is_bag(path)

    def load(self, path: Path, crop: Crop | None) -> Recording:
        """See :class:`litsim_sim.scenario.load.RecordingFormat`."""
        from litsim_data.generic.autoware_bag import read_bag  # loads rosbags, which other formats do not need

        if crop:
            raise InputError(f"{path}: a bag has no columns to crop; convert it, and crop the recording")
        return read_bag(path).recording


def bag_file(path: Path) -> Path:
    """Returns the ``metadata.yaml`` of a bag that is a folder; any other path as it is."""
    return path / METADATA_FILE if (path / METADATA_FILE).is_file() else path


def is_bag(path: Path) -> bool:
    """Returns whether the file at `path` is a bag, or the ``metadata.yaml`` of one."""
    if not path.is_file():
        return False
    head = read_head(path)
    return head.startswith(MAGIC) or (path.name == METADATA_FILE and METADATA_FIELD in head)
