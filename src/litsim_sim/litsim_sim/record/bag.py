"""Writing and reading of MCAP files in rosbag2's layout, with raw CDR messages, without ROS.

The writer takes serialised messages and definitions as text: it serves the recorder node, tests and converters alike.
Nothing in a file depends on the wall clock: the same calls give the same bytes. A killed writer loses at most the chunk
it was filling, and a chunk holds at most one second of simulation.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from textwrap import indent
from types import TracebackType
from typing import Any, BinaryIO, Self

import yaml
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema, Statistics
from mcap.writer import LIBRARY_IDENTIFIER, CompressionType, Writer

from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import require_file
from litsim_sim.record.mcap_survey import DAMAGE, Place, damage_at, parse, records_of, survey

METADATA_FILE = "metadata.yaml"
ROS_DISTRO, METADATA_VERSION = "jazzy", 9  # version of rosbag2's metadata.yaml since then
ROSBAG2_RECORD = "rosbag2"
FORMAT = 1
"""Version of a recording's content: topics, message definitions, attachments, metadata. It increases if an earlier
reader could misread something, but not for mere additions (CHANGELOG.md)."""
FORMAT_KEY = "record_format"  # key in the metadata of a run; recordings without it are of version 1
CHUNK_BYTES = 256 * 1024  # size of a chunk before compression
CHUNK_SPAN_NS = 1_000_000_000  # largest span of simulation time in a chunk
RECORD_BYTES = 31  # size of an MCAP message record without its data
DERIVED_FILES = ("metrics.json", "series.parquet", "takeovers.parquet", "overview.png", "report.html")
"""Files computed from a bag, out of date once the bag is overwritten."""
FAILURE_FILE = "failure.txt"
"""File beside the bag of a failed run with the reason, see :mod:`litsim_sim.record.failure`; out of date likewise."""
SEAL_FILE = "seal.json"
"""File beside the bag with what its run came to, see :mod:`litsim_sim.record.seal`; out of date likewise."""
# libyaml, where PyYAML was built with it, is ten times as fast, and most of what closing a bag takes
YAML_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
YAML_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@cache
def qos_yaml(depth: int, durability: str = "volatile") -> str:
    """Returns a reliable QoS profile as the YAML list that rosbag2 stores, without deadline, lifespan or lease."""
    infinite = {"sec": 9223372036, "nsec": 854775807}
    profile: dict[str, Any] = {
        "history": "keep_last",
        "depth": depth,
        "reliability": "reliable",
        "durability": durability,
        "deadline": dict(infinite),
        "lifespan": dict(infinite),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(infinite),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False)


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag.

    Attributes:
        name: topic.
        type_name: `package/msg/Type`.
        definition: message definitions, concatenated for encoding `ros2msg`.
        qos_yaml: YAML list of the offered QoS profiles.
        type_hash: `RIHS01_...`, or empty.
    """

    name: str
    type_name: str
    definition: str
    qos_yaml: str = "[]"
    type_hash: str = ""


@dataclass(frozen=True)
class BagMessage:
    """One message: serialised, at its log time (simulation time) [ns]."""

    topic: str
    log_time_ns: int
    data: bytes


class BagWriter:
    """Writes `folder/NAME_0.mcap` and, on :meth:`close`, `folder/metadata.yaml`.

    Use it as a context manager, or call :meth:`close`; after an exception the file is left as a killed writer would
    leave it. Every method raises InputError if the disk is full or the file cannot be written.
    """

    def __init__(self, folder: Path, name: str, *, overwrite: bool = False) -> None:
        """Create the file `name`.

        Raises an InputError if `folder` holds a bag already and not `overwrite`, is not a folder, or cannot be
        written.
        """
        self.path = folder / f"{name}_0.mcap"
        self._topics: dict[str, BagTopic] = {}
        self._counts: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._chunk_bytes = 0
        self._chunk_start_ns = 0
        self._stream: BinaryIO | None = None
        with self._writing():
            make_room(folder, overwrite)
            self._stream = self.path.open("xb")
            # Chunks are finished here, not by the library: it would do so only after a message that is too much.
            self._writer = Writer(
                self._stream, chunk_size=2**62, compression=CompressionType.ZSTD, enable_data_crcs=True
            )
            self._writer.start(profile="ros2", library=f"litsim {LIBRARY_IDENTIFIER}")
            self._writer.add_metadata(ROSBAG2_RECORD, {"ROS_DISTRO": ROS_DISTRO})
            self._stream.flush()

    def add_topic(self, topic: BagTopic) -> None:
        """Announce a topic before its first message."""
        if topic.name in self._topics:
            raise ValueError(f"topic {topic.name} was added already")
        if not topic.qos_yaml.lstrip().startswith(("-", "[")):
            raise ValueError(f"topic {topic.name}: QoS must be a YAML list of profiles, got {topic.qos_yaml!r}")
        with self._writing():
            if topic.type_name not in self._schemas:
                definition = topic.definition.encode()
                self._schemas[topic.type_name] = self._writer.register_schema(topic.type_name, "ros2msg", definition)
            metadata = {"offered_qos_profiles": topic.qos_yaml, "topic_type_hash": topic.type_hash}
            schema = self._schemas[topic.type_name]
            self._channels[topic.name] = self._writer.register_channel(topic.name, "cdr", schema, metadata)
        self._topics[topic.name] = topic
        self._counts[topic.name] = 0

    def write(self, topic: str, cdr: bytes, log_time_ns: int) -> None:
        """Append a serialised message (with its encapsulation header) at simulation time `log_time_ns`."""
        size = RECORD_BYTES + len(cdr)
        late = log_time_ns - self._chunk_start_ns >= CHUNK_SPAN_NS
        if self._chunk_bytes and (late or self._chunk_bytes + size > CHUNK_BYTES):
            self.sync()
        if not self._chunk_bytes:
            self._chunk_start_ns = log_time_ns
        self._chunk_bytes += size
        with self._writing():
            self._writer.add_message(self._channels[topic], log_time_ns, cdr, log_time_ns, self._counts[topic])
        self._counts[topic] += 1
        self._first_ns = log_time_ns if self._first_ns is None else min(self._first_ns, log_time_ns)
        self._last_ns = max(self._last_ns, log_time_ns)

    def sync(self) -> None:
        """Finish the open chunk and write it to the operating system.

        Called automatically after 256 KiB or a second of simulation. Calls driven by the wall clock change the
        boundaries of chunks, and thus the bytes of the file.
        """
        with self._writing():
            self._writer.flush()
        self._chunk_bytes = 0

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add a file to the bag."""
        with self._writing():
            self._writer.add_attachment(0, 0, name, media_type, data)
            self._flush()

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a metadata record, for facts known only at the end."""
        with self._writing():
            self._writer.add_metadata(name, values)
            self._flush()

    def close(self) -> None:
        """Finish the MCAP file and write `metadata.yaml`. A second call does nothing."""
        if self._stream is None:
            return
        information = _dump(self._information())
        with self._writing():
            self.sync()
            self._writer.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": information})
            self._writer.finish()
            self._stream.close()
            self._stream = None
            metadata = f"rosbag2_bagfile_information:\n{indent(information, '  ')}"
            (self.path.parent / METADATA_FILE).write_text(metadata)

    def abort(self) -> None:
        """Release the file unfinished, as a kill would."""
        stream, self._stream = self._stream, None
        if stream is not None:
            with suppress(OSError):
                stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def _flush(self) -> None:
        if self._stream is None:
            raise ValueError(f"{self.path}: the bag is closed")
        self._stream.flush()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Convert errors of the operating system to one that names the file."""
        try:
            yield
        except OSError as error:
            self.abort()
            raise InputError(f"{self.path}: cannot write the recording: {error.strerror or error}") from error

    def _information(self) -> dict[str, Any]:
        """rosbag2's BagMetadata, in the order and types of its YAML version 9."""
        start = self._first_ns or 0
        span: dict[str, Any] = {
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": max(0, self._last_ns - start)},
            "message_count": sum(self._counts.values()),
        }
        topics = [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": deepcopy(_profiles(topic.qos_yaml)),  # else YAML would name it by anchors
                    "type_description_hash": topic.type_hash,
                },
                "message_count": self._counts[topic.name],
            }
            for topic in self._topics.values()
        ]
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": dict(span["duration"]),
            "starting_time": dict(span["starting_time"]),
            "message_count": span["message_count"],
            "topics_with_message_count": topics,
            "compression_format": "",  # of whole files or messages; chunks are the storage's own business
            "compression_mode": "",
            "relative_file_paths": [self.path.name],
            "files": [{"path": self.path.name, **span}],
            "custom_data": None,
            "ros_distro": ROS_DISTRO,
        }


@cache
def _profiles(qos_yaml: str) -> Any:
    return yaml.load(qos_yaml, YAML_LOADER)  # noqa: S506 - safe


def _dump(tree: dict[str, Any]) -> str:
    return yaml.dump(
        tree, Dumper=YAML_DUMPER, sort_keys=False, default_flow_style=False, allow_unicode=True, width=2**16
    )


def make_room(folder: Path, overwrite: bool) -> None:
    """Make a folder for a bag, in place of an old one and what came of it; raises InputError unless `overwrite`."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: exists and is not a folder; give another --out")
    folder.mkdir(parents=True, exist_ok=True)
    bag = [*sorted(folder.glob("*.mcap")), *folder.glob(METADATA_FILE)]
    if bag and not overwrite:
        raise InputError(f"{folder}: holds a bag already ({bag[0].name}); give another folder")
    discard_derived(folder)
    for path in [*bag, folder / FAILURE_FILE, folder / SEAL_FILE]:
        path.unlink(missing_ok=True)


def discard_derived(folder: Path) -> None:
    """Removes what was computed from the bag in `folder`, or what somebody else says was."""
    for name in DERIVED_FILES:
        (folder / name).unlink(missing_ok=True)


class BagReader:
    """Reads a bag, complete or truncated; a damaged one is refused.

    Attributes:
        path: the MCAP file.
        topics: topics by name.
        attachments: contents by name.
        metadata: metadata of the run; later records override earlier ones.
        complete: whether the writer was closed; if not, everything up to the last complete chunk is read.
        problem: why the file is incomplete; empty for a complete one.
    """

    def __init__(self, path: Path) -> None:
        """Open the folder of a bag, or its MCAP file, and check that its bytes are those that were written.

        Raises:
            InputError: the file is missing, the folder has several MCAP files, or the file is not MCAP, is damaged, or
                is of a later version of the format.
        """
        self.path = find_mcap(path)
        self.topics: dict[str, BagTopic] = {}
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, str] = {}
        self._channels: dict[int, str] = {}
        self._schemas: dict[int, Schema] = {}
        self._counts: dict[int, int] = {}  # of messages by channel, as the writer has counted them; empty if it has not
        self._survey = survey(self.path)
        self.complete = self._survey.cut is None
        self.problem = "" if self.complete else f"cut short at byte {self._survey.cut}"
        described = any(place.opcode == Opcode.CHANNEL for place in self._survey.summary)
        chunks = () if described else (Opcode.CHUNK,)  # without a summary, what they hold is not known beforehand
        for record in (
            *self._records(self._survey.summary, {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS}),
            *self._records(self._survey.data, {Opcode.ATTACHMENT, Opcode.METADATA, *chunks}),
        ):
            self._note(record)
        version = self.metadata.get(FORMAT_KEY, "1")
        if not version.isdecimal() or int(version) > FORMAT:
            raise InputError(
                f"{self.path}: a record of format {version!r}, expected at most {FORMAT}; the LitSim that wrote it, "
                "or a later one, reads it"
            )

    def messages(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Yields messages in the order of the file, of `topics` or of all; raises InputError if the file is damaged."""
        if topics is not None and not self._has(topics):
            return
        for record in self._records(self._survey.data, {Opcode.MESSAGE, Opcode.CHUNK}):
            if isinstance(record, Message):
                topic = self._channels.get(record.channel_id)
                if topic is None:
                    raise InputError(f"{self.path}: a message at {record.log_time} ns is of no topic that is described")
                if topics is None or topic in topics:
                    yield BagMessage(topic, record.log_time, record.data)

    def _has(self, topics: Collection[str]) -> bool:
        """Returns whether there may be messages of `topics`."""
        counted = [self._channels.get(channel) for channel, count in self._counts.items() if count]
        return not counted or None in counted or any(topic in topics for topic in counted)

    def _note(self, record: McapRecord | None) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in self._channels:
            try:
                schema = self._schemas[record.schema_id]
                definition = schema.data.decode()
            except (KeyError, UnicodeDecodeError) as error:
                raise InputError(f"{self.path}: topic {record.topic}: no definition that can be read") from error
            self._channels[record.id] = record.topic
            qos, type_hash = (record.metadata.get(k, "") for k in ("offered_qos_profiles", "topic_type_hash"))
            self.topics[record.topic] = BagTopic(record.topic, schema.name, definition, qos, type_hash)
        elif isinstance(record, Statistics):
            self._counts = record.channel_message_counts
        elif isinstance(record, Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, Metadata) and record.name != ROSBAG2_RECORD:
            self.metadata.update(record.metadata)

    def _records(self, places: Iterable[Place], kinds: Collection[int]) -> Iterator[McapRecord | None]:
        """Yields the records of `kinds` among `places`, chunks opened."""
        with self.path.open("rb") as stream:
            for place in places:
                if place.opcode not in kinds:
                    continue
                stream.seek(place.content)
                try:
                    record = parse(place, stream.read(place.end - place.content))
                    inside = records_of(record, self.path) if isinstance(record, Chunk) else [record]
                except DAMAGE as error:
                    kind = Opcode(place.opcode).name.lower()
                    what = f"a {kind} that is not what was written ({type(error).__name__})"
                    raise damage_at(self.path, place.begin, what) from error
                yield from inside


def find_mcap(path: Path) -> Path:
    """Returns the MCAP file of a bag given as its folder or as the file itself; raises InputError if it is not one."""
    if not path.is_dir():
        require_file(path, "bag")
        return path
    files = sorted(path.glob("*.mcap"))
    if len(files) != 1:
        raise InputError(f"{path}: expected one MCAP file in the folder, found {len(files)}")
    return files[0]
