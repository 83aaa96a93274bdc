"""Repair of truncated bags: copies everything that can be read to a complete bag, and lists the losses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC as MAGIC

from litsim_sim.core.errors import InputError
from litsim_sim.record.bag import ROSBAG2_RECORD, BagTopic, BagWriter, find_mcap
from litsim_sim.record.failure import read_failure, write_failure
from litsim_sim.record.mcap_survey import DAMAGE, REPAIR_HINT, attachment_is_whole, parse, places, records_of, survey
from litsim_sim.record.player import offered_qos
from litsim_sim.record.run import LOST_ATTACHMENTS, read_run

NO_QOS = "[]"  # profiles of a topic whose QoS is unknown
REPAIR_RECORD = "repair"  # name of the metadata record with the losses
LOST_ATTACHMENT = "a damaged attachment "
_SECOND_NS = 1e9


@dataclass
class Repaired:
    """Result of a repair.

    Attributes:
        path: the new MCAP file.
        messages: number of messages kept, by topic.
        attachments: names of the attachments kept.
        lost: one sentence per loss; empty if the file was complete.
    """

    path: Path
    messages: Counter[str] = field(default_factory=Counter)
    attachments: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)


def repair(bag: Path, out: Path) -> Repaired:
    """Write everything that can be read of `bag` as a complete bag to the folder `out`.

    Damaged chunks are left out; records after them are kept.

    Raises:
        InputError: `bag` is not an MCAP file or holds no message, or `out` holds a bag or cannot be written.
    """
    source = find_mcap(bag)
    lost: list[str] = []
    records = list(_records(source, lost))
    if not lost:  # damage to a file whose records can all be read: in the metadata, or at the end
        try:
            survey(source)
        except InputError as error:
            lost.append(f"nothing that has a checksum of its own, yet {error}".removesuffix(REPAIR_HINT))
    described = {record.id for record in records if isinstance(record, Channel)}
    if not any(isinstance(record, Message) and record.channel_id in described for record in records):
        raise InputError(f"{source}: holds no message that can be read: there is nothing to make a bag of")
    name = out.resolve().name
    with BagWriter(out, name, {}) as writer:
        result = Repaired(writer.path, lost=lost)
        _copy(records, writer, result)
        writer.sync()
        lost += _steps_lost(writer.path)
        if lost:
            files = [loss.removeprefix(LOST_ATTACHMENT) for loss in lost if loss.startswith(LOST_ATTACHMENT)]
            writer.add_metadata(
                REPAIR_RECORD,
                {"repaired_from": source.name, "lost": "; ".join(lost)}
                | ({LOST_ATTACHMENTS: ", ".join(files)} if files else {}),
            )
    if failure := read_failure(source):
        write_failure(out, failure)
    return result


def _copy(records: list[McapRecord], writer: BagWriter, result: Repaired) -> None:
    """Write the records to the new bag; topics described only in damaged chunks are described as in the summary."""
    first = records[::-1]  # of two descriptions the first counts: that in a chunk, which has a checksum
    schemas = {record.id: record for record in first if isinstance(record, Schema) and _is_text(record.data)}
    channels = {record.id: record for record in first if isinstance(record, Channel) and record.schema_id in schemas}
    announced: set[int] = set()
    undescribed = 0
    for record in records:
        if isinstance(record, Channel | Message):
            number = record.id if isinstance(record, Channel) else record.channel_id
            if number in channels and number not in announced:
                announced.add(number)
                _announce(channels[number], schemas[channels[number].schema_id], writer, result)
        if isinstance(record, Message):
            if record.channel_id not in announced:
                undescribed += 1
                continue
            topic = channels[record.channel_id].topic
            writer.write(topic, record.data, record.log_time)
            result.messages[topic] += 1
        elif isinstance(record, Attachment):
            writer.attach(record.name, record.media_type, record.data)
            result.attachments.append(record.name)
        elif isinstance(record, Metadata) and record.name != ROSBAG2_RECORD:
            writer.add_metadata(record.name, record.metadata)
    if undescribed:
        result.lost.append(f"{undescribed} messages of topics that were described in a damaged chunk")


def _is_text(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def _announce(channel: Channel, schema: Schema, writer: BagWriter, result: Repaired) -> None:
    """Add a topic to the new bag, without its QoS if that cannot be read."""
    qos = channel.metadata.get("offered_qos_profiles") or NO_QOS
    try:
        offered_qos(BagTopic(channel.topic, schema.name, "", qos))
    except InputError as error:
        result.lost.append(str(error))
        qos = NO_QOS
    type_hash = channel.metadata.get("topic_type_hash", "")
    writer.add_topic(channel.topic, schema.name, schema.data.decode(), qos, type_hash)


def _records(path: Path, lost: list[str]) -> Iterator[McapRecord]:
    """Yields every record up to the truncation, with those in chunks; losses are added to `lost`.

    Raises:
        InputError: it is not an MCAP file, or cannot be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not content.startswith(MAGIC):
        raise InputError(f"{path}: not an MCAP file")
    whole = len(MAGIC)  # bytes up to the end of the last record that was read
    for place in places(content):
        whole, inside = place.end, content[place.content : place.end]
        if place.opcode == Opcode.FOOTER:
            return
        try:
            record = parse(place, inside)
        except DAMAGE:
            lost.append(f"a damaged record at byte {place.begin}")
            continue
        if isinstance(record, Chunk):
            try:
                yield from records_of(record, path)
            except DAMAGE:
                first, last = record.message_start_time / _SECOND_NS, record.message_end_time / _SECOND_NS
                lost.append(f"a damaged chunk with the messages of {first:.1f} to {last:.1f} s")
        elif isinstance(record, Attachment) and not attachment_is_whole(inside):
            lost.append(f"{LOST_ATTACHMENT}{record.name}")
        elif record is not None:
            yield record
    size = len(content)
    rest = f": its last {size - whole} bytes hold no whole record" if size > whole else ""
    lost.append(f"what was not written yet: the file breaks off{rest}")


def _steps_lost(path: Path) -> list[str]:
    """Returns a text on the steps that a LitSim run announced and the bag lacks; nothing for other bags."""
    try:
        run = read_run(path)
    except InputError:
        return []
    expected, last = run.last_step, run.tables[-1].step
    missing = sorted(set(range(expected + 1)) - {table.step for table in run.tables})
    if not missing:
        return []
    return [f"{len(missing)} of {expected + 1} steps are missing, from step {missing[0]} on (the last is {last})"]
