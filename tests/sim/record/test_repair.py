"""Repair: whatever damage a bag has taken, what can be read is kept, and what is lost is said."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from litsim_msgs.msg import AgentStates, RunInfo
from mcap.writer import Writer
from rclpy.serialization import serialize_message

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import AgentTable
from litsim_sim.record.bag import BagReader, BagWriter, qos_yaml
from litsim_sim.record.failure import read_failure, write_failure
from litsim_sim.record.player import offered_qos
from litsim_sim.record.repair import repair
from litsim_sim.ros import messages, topics
from litsim_sim.ros.cdr import without_padding
from litsim_sim.ros.definitions import definition, type_hash, type_name

STEP_NS = 100_000_000
CHUNK_STEPS = 10  # a chunk holds one second
ZSTD = b"\x28\xb5\x2f\xfd"  # at the beginning of every chunk's data


def write(folder: Path, steps: int = 45) -> Path:
    """A message on two topics at each step, an attachment, and a metadata record at the end."""
    with BagWriter(folder, "run", {"seed": "7"}) as writer:
        for topic in ("/a", "/b"):
            writer.add_topic(topic, "std_msgs/msg/Int8", "int8 data", qos_yaml(100), "RIHS01_2")
        writer.attach("scenario.yaml", "application/yaml", b"name: demo\n")
        for step in range(steps):
            for topic in ("/a", "/b"):
                writer.write(topic, bytes([0, 1, 0, 0, step]), step * STEP_NS)
        writer.add_metadata("digest", {"digest": "00ff"})
    return folder / "run_0.mcap"


def steps_in(path: Path, topic: str = "/a") -> list[int]:
    return [m.log_time_ns // STEP_NS for m in BagReader(path).messages({topic})]


def cut(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])


def chunk_at(path: Path, number: int) -> int:
    """Where the data of a chunk begin."""
    at, content = -1, path.read_bytes()
    for _ in range(number + 1):
        at = content.index(ZSTD, at + 1)
    return at


def test_a_whole_bag_loses_nothing(tmp_path: Path) -> None:
    path = write(tmp_path / "bag")
    done = repair(path, tmp_path / "copy")
    before, after = BagReader(path), BagReader(tmp_path / "copy")
    assert (done.path, done.lost) == (tmp_path / "copy/copy_0.mcap", [])
    assert (done.messages, done.attachments) == ({"/a": 45, "/b": 45}, ["scenario.yaml"])
    assert list(after.messages()) == list(before.messages())
    assert (after.topics, after.attachments) == (before.topics, before.attachments)
    assert after.metadata == before.metadata == {"seed": "7", "digest": "00ff"}


def test_a_bag_cut_amid_a_chunk_keeps_the_whole_chunks(tmp_path: Path) -> None:
    path = write(tmp_path / "bag")
    cut(path, chunk_at(path, 2) + 20)
    kept = list(BagReader(path).messages())
    done = repair(tmp_path / "bag", tmp_path / "whole")  # the folder does as well
    again = BagReader(tmp_path / "whole")
    assert again.complete
    assert list(again.messages()) == kept
    assert steps_in(tmp_path / "whole") == list(range(2 * CHUNK_STEPS))
    (lost,) = done.lost
    assert lost.startswith("what was not written yet: the file breaks off: its last ")
    assert again.metadata == {"seed": "7", "repaired_from": "run_0.mcap", "lost": lost}
    information = yaml.safe_load((tmp_path / "whole/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["message_count"] == done.messages.total() == len(kept)


@pytest.mark.parametrize("number", [0, 1, 4])
def test_a_damaged_chunk_is_left_out_and_named(tmp_path: Path, number: int) -> None:
    path = write(tmp_path / "bag")
    content, at = bytearray(path.read_bytes()), chunk_at(path, number)
    content[at + 8 : at + 24] = bytes(16)
    path.write_bytes(content)
    done = repair(path, tmp_path / "whole")
    lost = range(CHUNK_STEPS * number, min(CHUNK_STEPS * (number + 1), 45))
    assert steps_in(tmp_path / "whole") == [step for step in range(45) if step not in lost]
    expected = f"a damaged chunk with the messages of {lost[0] / 10:.1f} to {lost[-1] / 10:.1f} s"
    assert done.lost == [expected]
    assert BagReader(tmp_path / "whole").metadata["lost"] == expected


def test_messages_that_nothing_describes_any_more_are_counted(tmp_path: Path) -> None:
    path = write(tmp_path / "bag")
    content, at = bytearray(path.read_bytes()), chunk_at(path, 0)
    content[at + 8 : at + 24] = bytes(16)  # it held the descriptions
    path.write_bytes(content[: chunk_at(path, 2)])  # and so would the summary
    with pytest.raises(InputError, match="there is nothing to make a bag of"):
        repair(path, tmp_path / "whole")
    assert not (tmp_path / "whole").exists()


def test_every_place_to_cut_a_bag_at_leaves_a_bag_or_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", steps=12)
    content, kept = path.read_bytes(), []
    for number, size in enumerate(range(9, len(content), 97)):
        path.write_bytes(content[:size])
        try:
            repair(path, tmp_path / f"whole{number}")
        except InputError:
            kept.append(0)
        else:
            assert BagReader(tmp_path / f"whole{number}").complete
            kept.append(len(steps_in(tmp_path / f"whole{number}")))
    assert kept == sorted(kept)  # the longer the file, the more there is
    assert {0, CHUNK_STEPS, 12} == set(kept)


def test_a_topic_whose_qos_cannot_be_read_is_kept_without(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Int8", "ros2msg", b"int8 data")
        channel = writer.register_channel("/a", "cdr", schema, {"offered_qos_profiles": "["})
        writer.add_message(channel, STEP_NS, b"\0\1\0\0\7", STEP_NS)
        writer.finish()
    (lost,) = repair(tmp_path / "a.mcap", tmp_path / "whole").lost
    assert lost.startswith("topic /a: offered_qos_profiles: malformed YAML: ")
    again = BagReader(tmp_path / "whole")
    assert [m.data for m in again.messages()] == [b"\0\1\0\0\7"]
    assert offered_qos(again.topics["/a"]) == {}


def test_steps_of_a_run_that_are_not_there_are_counted(tmp_path: Path) -> None:
    info = RunInfo(header=messages.header(0), run_id="run", total_steps=30, dt=0.1, scenario_yaml="start_frame: 0\n")
    table = AgentTable.empty(0)
    with BagWriter(tmp_path / "bag", "run", {}) as writer:
        for topic in (topics.RUN_INFO, topics.AGENTS):
            name = type_name(topic.type)
            writer.add_topic(topic.name, name, definition(name), qos_yaml(1), type_hash(name))
        writer.write(topics.RUN_INFO.name, serialize_message(info), 0)
        for step in [*range(20), 22]:
            message = messages.agents_to_message(table, "run", 30, 1)
            message.step = step
            writer.write(topics.AGENTS.name, without_padding(AgentStates)(serialize_message(message)), step * STEP_NS)
    done = repair(tmp_path / "bag", tmp_path / "whole")
    assert done.lost == ["10 of 31 steps are missing, from step 20 on (the last is 22)"]
    assert BagReader(tmp_path / "whole").metadata["lost"] == done.lost[0]
    assert np.array_equal(steps_in(tmp_path / "whole", topics.AGENTS.name), [*range(20), 22])


def test_why_a_run_has_failed_goes_along(tmp_path: Path) -> None:
    path = write(tmp_path / "bag")
    write_failure(path.parent, "the stack ended")
    assert read_failure(repair(path, tmp_path / "copy").path) == "the stack ended"


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = write(tmp_path / "bag")
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"holds a bag already \(run_0.mcap\); give another folder"):
        repair(path, tmp_path / "bag")
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"hello", "not an MCAP file"),
        (b"", "not an MCAP file"),
        (b"\x89MCAP0\r\n", "holds no message that can be read: there is nothing to make a bag of"),
        (None, "no such bag"),
    ],
)
def test_what_is_no_bag_is_refused_and_leaves_nothing(tmp_path: Path, content: bytes | None, expected: str) -> None:
    path = tmp_path / "a.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=expected):
        repair(path, tmp_path / "new")
    assert not (tmp_path / "new").exists()
