"""MCAP files: what the writer leaves is what two independent readers and our own find."""

import resource
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import yaml
import zstandard
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from litsim_sim.core.errors import InputError
from litsim_sim.record.bag import CHUNK_BYTES, BagReader, BagTopic, BagWriter, find_mcap, qos_yaml
from litsim_sim.record.mcap_survey import CHUNK_MAX, records_of

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = {"/pose": "geometry_msgs/msg/PoseStamped", "/text": "std_msgs/msg/String"}
STEP_NS = 100_000_000


def text_cdr(text: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types["std_msgs/msg/String"](data=text), "std_msgs/msg/String"))


def pose_cdr(step: int) -> bytes:
    types, ns = STORE.types, step * STEP_NS
    stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="map")
    point = types["geometry_msgs/msg/Point"](x=float(step), y=0.5, z=0.0)
    facing = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    pose = types["geometry_msgs/msg/Pose"](position=point, orientation=facing)
    message = types["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)
    return bytes(STORE.serialize_cdr(message, "geometry_msgs/msg/PoseStamped"))


def open_writer(folder: Path, **options: bool) -> BagWriter:
    writer = BagWriter(folder, "run", **options)
    writer.add_metadata("run", {"git": "abc", "seed": "7"})
    for topic, type_name in TYPES.items():
        definition, _ = STORE.generate_msgdef(type_name, ros_version=2)
        writer.add_topic(BagTopic(topic, type_name, definition, qos_yaml(10), STORE.hash_rihs01(type_name)))
    return writer


def write_bag(folder: Path, steps: int = 25, **options: bool) -> Path:
    with open_writer(folder, **options) as writer:
        writer.attach("scenario.yaml", "application/yaml", b"name: demo\n")
        for step in range(steps):
            writer.write("/pose", pose_cdr(step), step * STEP_NS)
            writer.write("/text", text_cdr(f"step {step} ä"), step * STEP_NS)
        writer.add_metadata("litsim", {"digest": "00ff"})
    return folder / "run_0.mcap"


def test_two_other_readers_find_what_was_written(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag")
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        found = [(m.channel.topic, m.message.log_time, m.decoded_message) for m in reader.iter_decoded_messages()]
        channels = {c.topic: c.metadata for c in reader.get_summary().channels.values()}
    poses = [(t, m) for topic, t, m in found if topic == "/pose"]
    assert [m.pose.position.x for _, m in poses] == [float(k) for k in range(25)]
    assert [t for t, _ in poses] == [k * STEP_NS for k in range(25)]
    assert channels["/pose"]["offered_qos_profiles"].startswith("- history: keep_last\n  depth: 10\n")
    assert channels["/pose"]["topic_type_hash"].startswith("RIHS01_")

    with Reader(tmp_path / "bag") as bag:
        assert bag.message_count == 50
        assert bag.duration == 24 * STEP_NS + 1
        assert bag.ros_distro == "jazzy"
        assert {c.topic: (c.msgtype, c.msgcount) for c in bag.connections} == {k: (v, 25) for k, v in TYPES.items()}
        (qos,) = bag.connections[0].ext.offered_qos_profiles
        assert (qos.reliability.name, qos.durability.name, qos.depth) == ("RELIABLE", "VOLATILE", 10)
        texts = [STORE.deserialize_cdr(d, c.msgtype).data for c, _, d in bag.messages() if c.topic == "/text"]
    assert texts == [f"step {k} ä" for k in range(25)]


def test_metadata_yaml_is_that_of_rosbag2_and_in_the_file_too(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag")
    information = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["starting_time"] == {"nanoseconds_since_epoch": 0}
    assert information["duration"] == {"nanoseconds": 24 * STEP_NS}
    assert information["relative_file_paths"] == ["run_0.mcap"]
    assert information["files"][0]["message_count"] == 50
    topic = information["topics_with_message_count"][0]
    assert topic["message_count"] == 25
    assert topic["topic_metadata"]["offered_qos_profiles"][0]["depth"] == 10
    with path.open("rb") as stream:
        records = [m.metadata for m in make_reader(stream).iter_metadata() if m.name == "rosbag2"]
    assert records[0] == {"ROS_DISTRO": "jazzy"}
    assert yaml.safe_load(records[1]["serialized_metadata"]) == information


def test_reader_finds_topics_attachments_metadata_and_bytes(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag")
    reader = BagReader(tmp_path / "bag")
    assert reader.complete
    assert not reader.problem
    assert reader.attachments == {"scenario.yaml": b"name: demo\n"}
    assert reader.metadata == {"git": "abc", "seed": "7", "digest": "00ff"}
    assert {t.name: t.type_name for t in reader.topics.values()} == TYPES
    messages = list(reader.messages({"/pose"}))
    assert [(m.log_time_ns, m.data) for m in messages] == [(k * STEP_NS, pose_cdr(k)) for k in range(25)]
    assert len(list(reader.messages())) == 50


def test_chunks_are_not_read_for_a_topic_without_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_writer(tmp_path / "bag") as writer:
        writer.write("/text", text_cdr("only"), 0)
    reader = BagReader(tmp_path / "bag")
    assert len(list(reader.messages({"/text"}))) == 1
    monkeypatch.setattr("litsim_sim.record.bag.records_of", lambda *_: pytest.fail("a chunk was read"))
    assert not list(reader.messages({"/pose"})) and not list(reader.messages({"/other"}))


def test_equal_calls_give_equal_files(tmp_path: Path) -> None:
    one, two = write_bag(tmp_path / "one"), write_bag(tmp_path / "two")
    assert one.read_bytes() == two.read_bytes()
    assert (tmp_path / "one/metadata.yaml").read_bytes() == (tmp_path / "two/metadata.yaml").read_bytes()


def test_chunks_are_bounded_in_bytes_and_time(tmp_path: Path) -> None:
    with open_writer(tmp_path / "bag") as writer:
        for step in range(40):
            writer.write("/text", text_cdr("x" * (100_000 if step < 10 else 10)), step * STEP_NS)
        writer.write("/text", text_cdr("x" * 2 * CHUNK_BYTES), 40 * STEP_NS)
    with (tmp_path / "bag/run_0.mcap").open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert all(c.message_end_time - c.message_start_time < 10**9 for c in chunks)
    sizes = [c.uncompressed_size for c in chunks]
    definitions = 3000
    assert max(sizes[:-1]) <= CHUNK_BYTES + definitions
    assert sizes[-1] > 2 * CHUNK_BYTES
    assert len(chunks) == 5 + 3 + 1


def test_killed_writer_loses_its_last_chunk_only(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "bag")
    writer.attach("net.xml", "application/xml", b"<net/>")
    for step in range(25):
        writer.write("/pose", pose_cdr(step), step * STEP_NS)
    copy = tmp_path / "killed.mcap"  # what the operating system has, as after SIGKILL
    copy.write_bytes(writer.path.read_bytes())
    writer.abort()
    reader = BagReader(copy)
    assert not reader.complete
    assert "cut short" in reader.problem
    assert reader.attachments == {"net.xml": b"<net/>"}
    assert reader.metadata["git"] == "abc"
    assert [m.data for m in reader.messages()] == [pose_cdr(k) for k in range(20)]


def test_damaged_chunk_is_named_and_nothing_is_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag")
    with path.open("rb") as stream:
        second = make_reader(stream).get_summary().chunk_indexes[1]
    data = bytearray(path.read_bytes())
    middle = second.chunk_start_offset + second.chunk_length // 2
    data[middle : middle + 8] = b"\xff" * 8
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"run_0\.mcap: damaged at byte \d+: "):
        BagReader(path)
    path.write_bytes(data[: second.chunk_start_offset + second.chunk_length + 1])  # no checksum of the whole any more
    with pytest.raises(InputError, match=rf"damaged at byte {second.chunk_start_offset}: a chunk that is not what was"):
        BagReader(path)


def test_existing_bag_is_refused_unless_told(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    write_bag(folder)
    (folder / "metrics.json").write_text("{}")
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds a bag already"):
        open_writer(folder)
    assert (folder / "metrics.json").exists()
    write_bag(folder, steps=3, overwrite=True)
    assert len(list(BagReader(folder).messages())) == 6
    assert not (folder / "metrics.json").exists()
    assert (folder / "notes.txt").read_text() == "mine"


def test_output_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: exists and is not a folder"):
        open_writer(tmp_path / "file")
    with pytest.raises(InputError, match="cannot write the recording: Not a directory"):
        open_writer(tmp_path / "file/bag")


def test_full_disk_is_said_and_leaves_what_was_written(tmp_path: Path) -> None:
    program = f"""
        import os
        from litsim_sim.record.bag import BagTopic, BagWriter, qos_yaml
        from litsim_sim.core.errors import InputError
        from pathlib import Path
        try:
            with BagWriter(Path({str(tmp_path / "bag")!r}), "run") as writer:
                writer.add_topic(BagTopic("/text", "std_msgs/msg/String", "string data\\n", qos_yaml(1), ""))
                for step in range(100):
                    writer.write("/text", bytes([0, 1, 0, 0]) + os.urandom(10_000), step * {STEP_NS})
        except InputError as error:
            print(error)
    """

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))

    command = [sys.executable, "-c", textwrap.dedent(program)]
    done = subprocess.run(command, preexec_fn=limit, capture_output=True, text=True, check=True)
    assert "run_0.mcap: cannot write the recording: File too large" in done.stdout
    assert not done.stderr
    reader = BagReader(tmp_path / "bag")
    assert not reader.complete
    assert len(list(reader.messages())) == 20


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such bag"):
        find_mcap(tmp_path / "none")
    with pytest.raises(InputError, match="expected one MCAP file in the folder, found 0"):
        find_mcap(tmp_path)
    (tmp_path / "x.mcap").write_text("hello")
    with pytest.raises(InputError, match="not an MCAP file"):
        BagReader(tmp_path)


def test_wrong_calls_are_refused(tmp_path: Path) -> None:
    with open_writer(tmp_path / "bag") as writer:
        with pytest.raises(ValueError, match="added already"):
            writer.add_topic(BagTopic("/pose", "std_msgs/msg/String", "string data\n", qos_yaml(1), ""))
        with pytest.raises(ValueError, match="QoS must be a YAML list"):
            writer.add_topic(BagTopic("/new", "std_msgs/msg/String", "string data\n", "reliable", ""))


@pytest.mark.parametrize("stated", [2**40, 10])
def test_a_chunk_that_would_fill_the_memory_is_not_unpacked(stated: int) -> None:
    """By what its record says, or, where that is wrong, by what the compressed data say."""
    data = zstandard.compress(bytes(CHUNK_MAX + 1))
    chunk = Chunk("zstd", data, message_end_time=0, message_start_time=0, uncompressed_crc=0, uncompressed_size=stated)
    with pytest.raises(InputError, match=r"^run\.mcap: a chunk unpacks to \d+ bytes, expected at most \d+$"):
        records_of(chunk, Path("run.mcap"))
