"""Bytes between fields are cleared; fields are not. On whole recordings, test_recording.py asks another serialiser."""

from typing import Any

import pytest
from litsim_msgs.msg import AgentStates, RunInfo, StageStatus
from nav_msgs.msg import Path
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from litsim_sim.ros import messages
from litsim_sim.ros.cdr import run_id_of, stamp_ns, without_padding

SOIL = b"\xaa\xbb\xcc\xdd\xee\xff\x99"
AFTER_FRAME = 4 + 8 + 4 + 2  # encapsulation, stamp, length of the frame's name, "a" and its NUL
HEADER = Header(frame_id="a")


def soiled(data: bytes, *places: tuple[int | bytes, int]) -> bytes:
    """Serialised data with dirt; places are (offset, or bytes that end there; number of bytes)."""
    dirty = bytearray(data)
    for place, count in places:
        at = place if isinstance(place, int) else data.index(place) + len(place)
        dirty[at : at + count] = SOIL[:count]
    return bytes(dirty)


@pytest.mark.parametrize(
    ("message", "places"),
    [
        (StageStatus(header=HEADER, step=5, text="ab"), [(AFTER_FRAME, 2)]),
        (StageStatus(header=HEADER, run_id="wxyz", step=7, stage="s", state=3), [(AFTER_FRAME, 2), (b"wxyz\0", 3)]),
        (AgentStates(header=HEADER, kind=[7] * 3, controller=[8] * 5), [(b"\7\7\7", 1), (b"\x08" * 5, 3)]),
        (RunInfo(header=HEADER, stages=["kkkk", "l"]), [(b"kkkk\0", 3), (b"l\0", 2)]),
        (Path(header=HEADER), [(AFTER_FRAME, 2)]),
    ],
)
def test_padding_is_cleared_and_nothing_else(message: Any, places: list[tuple[int | bytes, int]]) -> None:
    clear, data = without_padding(type(message)), serialize_message(message)
    dirty, cleared = soiled(data, *places), clear(data)
    assert dirty != cleared
    assert clear(dirty) == cleared
    assert sum(byte in SOIL for byte in cleared) == 0
    assert deserialize_message(cleared, type(message)) == message


def test_what_follows_the_last_field_is_cut_off() -> None:
    clear = without_padding(AgentStates)
    data = serialize_message(AgentStates())  # rclpy reserves more than empty arrays take
    assert clear(data + b"12345678") == clear(data)
    assert len(clear(data)) < len(data)


def test_what_is_not_understood_stays_as_it_is() -> None:
    clear, data = without_padding(StageStatus), serialize_message(StageStatus(stage="ego", text="abc"))
    for odd in (b"\x00\x00" + data[2:], data[:-8], data[:30], b""):
        assert clear(odd) == odd


@pytest.mark.parametrize("step", [0, 7, 123])
def test_the_stamp_is_read_without_the_rest(step: int) -> None:
    told = (messages.status("run", "ego", 1, step), Clock(clock=messages.stamp(step)))
    assert [stamp_ns(serialize_message(each)) for each in told] == [step * 100_000_000] * 2


@pytest.mark.parametrize("run_id", ["", "a", "short-idm-litsim-13-0@ü7", "x" * 300])
@pytest.mark.parametrize("frame", ["", "map", "abcd"])
def test_the_run_is_read_without_the_rest(run_id: str, frame: str) -> None:
    header = Header(frame_id=frame)
    for message in (AgentStates(header=header, run_id=run_id, step=3), StageStatus(header=header, run_id=run_id)):
        assert run_id_of(serialize_message(message)) == run_id
