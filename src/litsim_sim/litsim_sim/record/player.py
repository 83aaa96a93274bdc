"""Playing a bag: the schedule of its messages, at any rate, with pauses and seeks. Without ROS.

There are two clocks: simulation time is that of the bag, in nanoseconds; wall time is passed by the caller as `now`, in
seconds of a monotonic clock.
"""

from __future__ import annotations

import struct
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterable, Sequence
from math import inf
from typing import Any

from litsim_sim.core import topic_names
from litsim_sim.core.errors import InputError
from litsim_sim.io.yaml_input import load_yaml
from litsim_sim.record.bag import BagMessage, BagReader, BagTopic, qos_yaml

CLOCK = BagTopic(topic_names.CLOCK, "rosgraph_msgs/msg/Clock", "", qos_yaml(10))
SECOND_NS = 1_000_000_000
RATE_MIN, RATE_MAX = 0.01, 100.0
FRAME_NS = 100_000_000  # [ns] duration of the last step of a loop, for a bag with only one step


class Player:
    """Determines which messages are to be published at any time.

    Messages of one log time belong to one step of the simulation; seeks never split it. No message is skipped: those
    that became due between two calls are returned by the next. After a seek, latched topics first repeat their last
    message before the new position.

    Attributes:
        rate: simulated seconds per second.
        paused: whether time stands still.
        loop: whether it starts again after the end.
    """

    def __init__(
        self,
        messages: Iterable[BagMessage],
        latched: Collection[str] = (),
        *,
        rate: float = 1.0,
        start_s: float = 0.0,
        loop: bool = False,
        paused: bool = False,
    ) -> None:
        """Play `messages`, from `start_s` seconds after the first of them on.

        Raises:
            InputError: there are no messages, `rate` cannot be played at, or `start_s` lies outside of the bag.
        """
        self._messages = sorted(messages, key=lambda message: message.log_time_ns)  # stable: else the order of the file
        if not self._messages:
            raise InputError("nothing to play: the bag holds no messages on the topics asked for")
        first = self._messages[0].log_time_ns  # of which floats are too coarse, if it counts from 1970
        self._times = [message.log_time_ns - first for message in self._messages]
        self._steps = sorted(set(self._times))
        self._latched = {
            topic: [i for i, message in enumerate(self._messages) if message.topic == topic] for topic in latched
        }
        if not 0.0 <= start_s <= self.duration_s:
            raise InputError(f"start is {start_s:g} s, expected 0 to {self.duration_s:g} s")
        if not RATE_MIN <= rate <= RATE_MAX:
            raise InputError(f"rate is {rate:g}, expected {RATE_MIN:g} to {RATE_MAX:g}")
        self.rate = rate
        self.loop = loop
        self.paused = paused
        self._next = 0  # index of the message that comes next
        self._sent: dict[str, int] = {}  # index of what each latched topic published last
        self._extra: list[BagMessage] = []  # due whatever the time
        self._at = 0.0  # simulation time since the first message at `_since` [ns]
        self._since: float | None = None  # wall time at which it was so; None while time stands still
        if start_s > 0.0:
            self._go(round(start_s * SECOND_NS))

    @property
    def duration_s(self) -> float:
        """From the first to the last message [s]."""
        return self._times[-1] / SECOND_NS

    @property
    def finished(self) -> bool:
        """Whether everything has been played; never while paused or in a loop."""
        return not (self.paused or self.loop or self._extra) and self._next == len(self._messages)

    def position_s(self, now: float) -> float:
        """Returns the simulation time since the first message [s]."""
        return min(self._position(now), self._times[-1]) / SECOND_NS

    def take(self, now: float) -> list[BagMessage]:
        """Returns messages that are due and have not been taken yet, in order."""
        due, self._extra = self._extra, []
        if self.paused:
            return due
        if self._since is None:
            self._since = now
        position = self._position(now)
        due += self._emit(bisect_right(self._times, position))
        if self.loop and position >= self._end:
            self._at, self._since, self._next = 0.0, now, 0
        return due

    def wait_s(self, now: float) -> float:
        """Returns the wall time until the next message is due [s]; infinite while paused."""
        if self._extra:
            return 0.0
        if self.paused:
            return inf
        due = self._times[self._next] if self._next < len(self._times) else self._end if self.loop else -inf
        return max(0.0, (due - self._position(now)) / SECOND_NS / self.rate)

    def pause(self, paused: bool, now: float) -> None:
        """Pause or resume."""
        self._anchor(now)
        self.paused = paused
        self._since = None if paused else now

    def seek(self, position_s: float, now: float) -> None:
        """Continue at `position_s` after the first message [s], or at the nearest position; while paused, show it."""
        self._anchor(now)
        self._go(round(min(max(position_s, 0.0), self.duration_s) * SECOND_NS))

    @property
    def _end(self) -> float:
        """Time at which a loop starts again: its last step lasts as long as the one before."""
        return self._times[-1] + (self._steps[-1] - self._steps[-2] if len(self._steps) > 1 else FRAME_NS)

    def _position(self, now: float) -> float:
        passed = 0.0 if self._since is None else now - self._since
        return self._at + passed * self.rate * SECOND_NS

    def _anchor(self, now: float) -> None:
        self._at = min(self._position(now), self._end)
        if self._since is not None:
            self._since = now

    def _go(self, time_ns: int) -> None:
        """Go to `time_ns` after the first message; whole nanoseconds, or 8.3 s might be later than a step at 8.3 s."""
        self._at, self._next = float(time_ns), bisect_left(self._times, time_ns)
        for topic, indices in self._latched.items():
            last = bisect_left(indices, self._next) - 1
            if last >= 0 and self._sent.get(topic) != indices[last]:
                self._extra.append(self._messages[indices[last]])
                self._sent[topic] = indices[last]
        if self.paused and self._next < len(self._times):
            self._at = float(self._times[self._next])
            self._extra += self._emit(bisect_right(self._times, self._at))

    def _emit(self, end: int) -> list[BagMessage]:
        """Returns the messages before index `end` that have not been returned yet."""
        first, self._next = self._next, max(self._next, end)
        for topic, indices in self._latched.items():
            last = bisect_left(indices, self._next) - 1
            if last >= 0 and indices[last] >= first:
                self._sent[topic] = indices[last]
        return self._messages[first : self._next]


def selected(reader: BagReader, names: Sequence[str] = ()) -> list[BagTopic]:
    """Returns the topics called `names`, or all, and the clock, in the bag or not; raises InputError for others."""
    unknown = sorted(set(names) - reader.topics.keys())
    if unknown:
        raise InputError(
            f"{reader.path}: no topic {', '.join(unknown)}; the bag holds {', '.join(sorted(reader.topics))}"
        )
    topics = [topic for name, topic in reader.topics.items() if not names or name in names or name == CLOCK.name]
    return topics if CLOCK.name in reader.topics else [CLOCK, *topics]


def messages_of(reader: BagReader, topics: Sequence[BagTopic]) -> list[BagMessage]:
    """Returns the messages of `topics`; where the bag has no clock, one for every log time ahead of its messages."""
    wanted = {topic.name for topic in topics}
    messages = list(reader.messages(wanted))
    if CLOCK.name not in wanted or any(message.topic == CLOCK.name for message in messages):
        return messages
    return [clock(time_ns) for time_ns in sorted({message.log_time_ns for message in messages})] + messages


def clock(time_ns: int) -> BagMessage:
    """Returns a serialised ``rosgraph_msgs/Clock``."""
    return BagMessage(CLOCK.name, time_ns, struct.pack("<4BiI", 0, 1, 0, 0, *divmod(time_ns, SECOND_NS)))


def offered_qos(topic: BagTopic) -> dict[str, Any]:
    """Returns the QoS policies that a topic was recorded with, by name; raises InputError if they are no YAML list."""
    where = f"topic {topic.name}: offered_qos_profiles"
    profiles = load_yaml(topic.qos_yaml or "[]", where)
    if not isinstance(profiles, list) or not all(isinstance(profile, dict) for profile in profiles):
        raise InputError(f"{where}: expected a YAML list of profiles, found {profiles!r:.60}")
    return profiles[0] if profiles else {}


def is_latched(topic: BagTopic) -> bool:
    """Returns whether late subscribers get the last message."""
    return bool(offered_qos(topic).get("durability") == "transient_local")
