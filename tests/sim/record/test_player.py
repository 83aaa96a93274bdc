"""Playing bags by a clock of the test's own."""

from dataclasses import replace
from math import inf
from pathlib import Path

import pytest

from command_line import refusal
from litsim_sim.cli import replay as command
from litsim_sim.core.errors import InputError
from litsim_sim.record.bag import BagMessage, BagReader, BagTopic, BagWriter, qos_yaml
from litsim_sim.record.player import CLOCK, Player, is_latched, messages_of, offered_qos, selected

STEP_NS = 100_000_000
DEFINITION = "builtin_interfaces/Time clock"


def step_messages(step: int) -> list[BagMessage]:
    return [BagMessage(topic, step * STEP_NS, bytes([step])) for topic in ("/clock", "/a")]


def player(steps: int = 20, begin_ns: int = 0, **options) -> Player:
    """Two messages a step, and a latched one at steps 0 and 5."""
    messages = [m for step in range(steps) for m in step_messages(step)]
    messages += [BagMessage("/map", step * STEP_NS, bytes([step])) for step in (0, 5)]
    return Player([replace(m, log_time_ns=begin_ns + m.log_time_ns) for m in messages], ["/map"], **options)


def steps_of(messages: list[BagMessage], topic: str = "/a") -> list[int]:
    return [m.data[0] for m in messages if m.topic == topic]


# Time


def test_messages_come_when_their_time_has_come() -> None:
    playing = player()
    assert steps_of(playing.take(100.0)) == [0]
    assert playing.wait_s(100.0) == pytest.approx(0.1)
    assert steps_of(playing.take(100.05)) == []
    assert steps_of(playing.take(100.1001)) == [1]
    assert playing.position_s(100.15) == pytest.approx(0.15)


def test_none_is_left_out_when_nobody_has_asked_for_long() -> None:
    playing = player()
    playing.take(0.0)
    late = playing.take(60.0)
    assert steps_of(late) == list(range(1, 20))
    assert [m.log_time_ns for m in late] == sorted(m.log_time_ns for m in late)
    assert playing.finished


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_rate_scales_time(rate: float) -> None:
    playing = player(rate=rate)
    playing.take(0.0)
    assert playing.wait_s(0.0) == pytest.approx(0.1 / rate)
    assert steps_of(playing.take(1.001 / rate)) == list(range(1, 11))


@pytest.mark.parametrize("rate", [0.0, -1.0, inf, float("nan"), 1000.0])
def test_rates_that_cannot_be_played_are_refused(rate: float) -> None:
    with pytest.raises(InputError, match="rate is"):
        player(rate=rate)


def test_the_end_is_the_end() -> None:
    playing = player(3)
    playing.take(0.0)
    assert not playing.finished
    assert playing.wait_s(0.0) > 0
    playing.take(9.0)
    assert playing.finished and playing.wait_s(9.0) == 0.0


# Pause


def test_while_paused_nothing_comes_and_no_time_passes() -> None:
    playing = player(paused=True)
    assert playing.take(0.0) == [] and playing.wait_s(0.0) == inf
    playing.pause(paused=False, now=50.0)
    assert steps_of(playing.take(50.0)) == [0]
    playing.pause(paused=True, now=50.25)
    assert playing.position_s(99.0) == pytest.approx(0.25)
    playing.pause(paused=False, now=100.0)
    assert steps_of(playing.take(100.051)) == [1, 2, 3]


# Seek and loop


def test_seek_goes_on_from_there_and_says_what_is_latched() -> None:
    playing = player()
    playing.take(0.0)
    playing.seek(1.0, 0.05)
    found = playing.take(0.05)
    assert [(m.topic, m.data[0]) for m in found] == [("/map", 5), ("/clock", 10), ("/a", 10)]
    playing.seek(0.2, 1.0)
    assert [(m.topic, m.data[0]) for m in playing.take(1.0)] == [("/map", 0), ("/clock", 2), ("/a", 2)]
    playing.seek(0.3, 1.0)
    assert steps_of(playing.take(1.0), "/map") == []  # known


def test_seek_while_paused_shows_one_step() -> None:
    playing = player(paused=True)
    playing.seek(0.95, 0.0)
    assert steps_of(playing.take(0.0)) == [10]
    assert playing.position_s(5.0) == pytest.approx(1.0)
    assert playing.take(5.0) == []


@pytest.mark.parametrize(("to", "step"), [(-3.0, 0), (99.0, 19)])
def test_seek_stays_within_the_bag(to: float, step: int) -> None:
    playing = player()
    playing.take(0.0)
    playing.seek(to, 0.0)
    assert steps_of(playing.take(0.0)) == [step]


@pytest.mark.parametrize("paused", [False, True])
def test_seek_to_a_step_finds_it_though_its_seconds_are_no_exact_float(*, paused: bool) -> None:
    """8.3 s are 8300000000.000001 ns, as floats go."""
    playing = player(200, paused=paused)
    for step in range(200):
        playing.seek(float(f"{0.1 * step:.1f}"), 0.0)
        assert steps_of(playing.take(0.0))[0] == step
    for step in (83, 161):
        assert steps_of(player(200, start_s=step / 10).take(0.0)) == [step]


def test_a_bag_in_time_since_1970_is_played_as_any_other() -> None:
    """There, a float of nanoseconds is off by up to 128: steps were not found."""
    for begin_ns in range(1_700_000_000_123_456_700, 1_700_000_000_123_456_900, 7):
        playing = player(begin_ns=begin_ns, paused=True)
        for step in (0, 1, 2, 12):
            playing.seek(step / 10, 0.0)
            assert steps_of(playing.take(0.0)) == [step]
            assert playing.position_s(0.0) == pytest.approx(step / 10, abs=1e-9)


def test_start_is_a_seek_and_must_lie_within() -> None:
    found = player(start_s=1.5).take(0.0)
    assert steps_of(found) == [15] and steps_of(found, "/map") == [5]
    with pytest.raises(InputError, match=r"start is 2 s, expected 0 to 1.9 s"):
        player(start_s=2.0)


def test_a_loop_lets_its_last_step_stand_as_long_as_the_others() -> None:
    playing = player(6, loop=True)
    now, seen = 0.0, []
    for _ in range(20):
        seen += [(round(now, 3), step) for step in steps_of(playing.take(now))]
        now += max(playing.wait_s(now), 1e-6)
    assert [step for _, step in seen][:8] == [0, 1, 2, 3, 4, 5, 0, 1]
    assert [t for t, _ in seen][5:8] == pytest.approx([0.5, 0.6, 0.7], abs=0.001)
    assert not playing.finished


def test_nothing_to_play_is_an_error() -> None:
    with pytest.raises(InputError, match="nothing to play"):
        Player([])


# What is in the bag


def write(folder: Path, steps: int = 25, *, clock: bool = True) -> Path:
    latched = qos_yaml(1, durability="transient_local")
    with BagWriter(folder, "run") as writer:
        if clock:
            writer.add_topic(BagTopic("/clock", CLOCK.type_name, DEFINITION, qos_yaml(10), "RIHS01_1"))
        writer.add_topic(BagTopic("/a", "std_msgs/msg/Int8", "int8 data", qos_yaml(100), "RIHS01_2"))
        writer.add_topic(BagTopic("/map", "std_msgs/msg/Int8", "int8 data", latched, "RIHS01_2"))
        writer.attach("scenario.yaml", "application/yaml", b"name: demo\n")
        writer.write("/map", b"\0", 0)
        for step in range(steps):
            for message in step_messages(step):
                if clock or message.topic != "/clock":
                    writer.write(message.topic, message.data, message.log_time_ns)
    return folder / "run_0.mcap"


def test_selected_topics_and_the_clock(tmp_path: Path) -> None:
    reader = BagReader(write(tmp_path / "bag"))
    assert [t.name for t in selected(reader)] == ["/clock", "/a", "/map"]
    chosen = selected(reader, ["/a"])
    assert [t.name for t in chosen] == ["/clock", "/a"]
    assert {m.topic for m in messages_of(reader, chosen)} == {"/clock", "/a"}
    with pytest.raises(InputError, match=r"no topic /b; the bag holds /a, /clock, /map"):
        selected(reader, ["/a", "/b"])


def test_a_bag_without_clock_gets_one(tmp_path: Path) -> None:
    reader = BagReader(write(tmp_path / "bag", 12, clock=False))
    topics = selected(reader)
    playing = Player(messages_of(reader, topics))
    taken = playing.take(0.0) + playing.take(60.0)
    clocks = [m for m in taken if m.topic == "/clock"]
    assert taken[0] is clocks[0] and len(clocks) == 12
    assert clocks[11].data == bytes([0, 1, 0, 0, 1, 0, 0, 0]) + STEP_NS.to_bytes(4, "little")


def test_qos_is_read_by_name(tmp_path: Path) -> None:
    topics = BagReader(write(tmp_path / "bag")).topics
    assert [name for name, topic in topics.items() if is_latched(topic)] == ["/map"]
    assert offered_qos(topics["/a"])["depth"] == 100
    assert offered_qos(BagTopic("/o", "t/msg/T", "")) == {}
    for text, why in (("[", "malformed YAML: "), ("depth: 3", "expected a YAML list of profiles, found {'depth': 3}")):
        with pytest.raises(InputError, match=f"^topic /o: offered_qos_profiles: {why}"):
            offered_qos(BagTopic("/o", "t/msg/T", "", text))


# The command


def test_delays_are_not_negative(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refusal(capsys, command.main, tmp_path, "--delay", "-1")
    assert "argument --delay: '-1', expected a number of at least 0" in said
