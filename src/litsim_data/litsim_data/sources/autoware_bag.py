"""ROS 2 bags of Autoware: tracked or predicted objects, the ego's odometry, and what traffic lights showed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from litsim_data.sources.source import Scene, Source
from litsim_sim.io.input_files import read_head

MCAP, SQLITE = b"\x89MCAP0\r\n", b"SQLite format 3\0"
METADATA_FILE, METADATA_FIELD = "metadata.yaml", b"rosbag2_bagfile_information"


class AutowareBag(Source):
    """A drive of Autoware, by the stamps of its messages; a map is not in the bag."""

    content = "a ROS 2 bag of Autoware (.mcap, .db3, or metadata.yaml of its folder)"
    licence = "unknown"
    citation = "ROS 2 bag of Autoware"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        head = read_head(path)
        of_ros = head.startswith(MCAP) and b"ros2" in head[:64]  # the profile of the file
        return of_ros or head.startswith(SQLITE) or (path.name == METADATA_FILE and METADATA_FIELD in head)

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:  # noqa: ARG002 - a bag has no map
        """See :class:`.source.Source`."""
        from litsim_data.sources.bag_messages import read_scene  # loads rosbags, which other data sets do not need

        folder = path.parent if path.name == METADATA_FILE else None
        yield read_scene(path, path.stem if folder is None else folder.name, folder or path)
