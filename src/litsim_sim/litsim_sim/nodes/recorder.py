"""The recorder: every topic of a run to MCAP, raw CDR, in the order of the simulation."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from litsim_msgs.msg import Hello, RunInfo, StageStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from litsim_sim.core.errors import InputError
from litsim_sim.core.lockstep import RECORDER_WINDOW
from litsim_sim.core.scene import STEP_NS
from litsim_sim.core.stages import BRIDGE
from litsim_sim.core.stages import RECORDER as STAGE
from litsim_sim.record.bag import BagWriter, qos_yaml
from litsim_sim.ros import messages
from litsim_sim.ros.cdr import stamp_ns, without_padding
from litsim_sim.ros.definitions import definition, type_hash, type_name
from litsim_sim.ros.stage import SIGNAL_PERIOD, check_parameters, process, reason, spin
from litsim_sim.ros.topics import (
    AGENTS,
    CLOCK,
    EGO_APPLIED,
    EGO_INPUTS,
    EGO_STATE,
    FOREIGN,
    HELLO,
    LANES,
    RECORDED,
    RECORDED_TOPICS,
    RUN_INFO,
    STATUS,
    Topic,
)
from litsim_sim.scenario.scenario import Scenario

CONFIRM_EVERY = 10  # steps
LAG = 2  # steps by which writing follows, so that timings, which nobody waits for, find their step
OF_THE_BRIDGE = (CLOCK.name, AGENTS.name, EGO_STATE.name)  # there at every step, whoever has missed an answer
HEARING_S = 10.0  # for every stage to be heard before the run begins: its READY holds its parameters
SETTLE_S = 0.05  # between two looks at whether all has come in
LINGER_S = 1.0  # for which a recorder that failed answers the bridge, which may not have heard it
OTHERS = tuple(topic.name for topic in FOREIGN)
AHEAD = 5  # steps by which what others publish may be ahead of the agents that have come in
REPEATS_MAX = 10  # of step 0 for which an external ego is given time to be met by the recorder as well
EGO_INPUT_NAMES = tuple(topic.name for topic in EGO_INPUTS.values())
KEPT = 20  # messages of one step that are kept on a topic that others publish on
NAMED = 3  # steps that a message about gaps names


class RecorderNode(Node):
    """Records one run, then :attr:`finished`.

    A step is confirmed to the bridge once each of the run's per-step topics holds it, and step 0 once an external ego
    has been heard, so that none of its answers is lost; where the bridge says that it
    goes on without an answer, once what the bridge itself publishes does. Steps are written in order, their messages
    in the order of :data:`RECORDED_TOPICS`, so that equal runs give equal records. An answer that comes after its
    step was written is written where it comes. What others than LitSim publish is kept as well, :data:`KEPT` messages
    of a topic and step, and where its stamp is not of about now, at the current step: it must not hold up anything.
    """

    def __init__(self) -> None:
        super().__init__(STAGE)
        self._output = Path(str(self.declare_parameter("output", "bags/run").value))
        overwrite = bool(self.declare_parameter("overwrite", False).value)  # noqa: FBT003 - its default
        check_parameters(self)
        self._writer = BagWriter(self._output, self._output.resolve().name, {}, overwrite=overwrite)
        self.finished = False
        self._run_id = ""
        self._word: StageStatus | None = None  # on the run at hand, repeated when the bridge greets
        self._unheard: set[str] = set()
        self._per_step: tuple[str, ...] = ()
        self._total = 0
        self._early: dict[str, bytes] = {}  # latched messages that came before the run was known
        self._pending: dict[int, dict[str, list[bytes]]] = {}
        self._next = 0  # step to be confirmed next
        self._written = 0  # step to be written next
        self._ending = False
        self._repeated = 0  # times that step 0 came in
        self._now = -1  # newest step of the agents
        self._kept: Counter[tuple[str, int]] = Counter()
        self._missed: set[int] = set()  # steps that the bridge went on from without all answers
        self._absent: set[tuple[int, str]] = set()  # what was not there when its step was written
        self._status = self.create_publisher(STATUS.type, STATUS.name, STATUS.qos)
        self._recorded = self.create_publisher(RECORDED.type, RECORDED.name, RECORDED.qos)
        for topic in RECORDED_TOPICS:
            self.create_subscription(topic.type, topic.name, self._receiver(topic), topic.qos, raw=True)
            name = type_name(topic.type)
            profile = topic.qos
            self._writer.add_topic(
                topic.name,
                name,
                definition(name),
                qos_yaml(profile.depth, durability="transient_local" if topic.latched else "volatile"),
                type_hash(name),
            )
        self.create_subscription(HELLO.type, HELLO.name, self._on_hello, HELLO.qos)

    @property
    def gaps(self) -> str:
        """In words, what the record lacks that it should hold; empty where it is whole."""
        lacking: dict[str, list[int]] = {}
        for step, name in sorted(self._absent):
            if step not in self._missed or name in OF_THE_BRIDGE:
                lacking.setdefault(name, []).append(step)
        return "; ".join(
            f"{name} lacks {len(steps)} steps ({', '.join(map(str, steps[:NAMED]))}{', ...' * (len(steps) > NAMED)})"
            for name, steps in lacking.items()
        )

    def close(self) -> None:
        """Write what is held, and finish the file."""
        if self.finished:
            return
        self.finished = True
        for step in range(self._written, max(self._pending, default=-1) + 1):
            self._write(step)
        self._writer.close()

    def abandon(self, text: str, linger: float) -> None:
        """Finish the file before the run is over, for `text`, and tell the bridge for `linger` seconds."""
        with suppress(InputError, ValueError):  # the file may be what is in the way
            self.close()
        self._say(StageStatus.FAILED, text)
        until = time.monotonic() + linger
        spin(self, lambda: time.monotonic() > until)

    def _receiver(self, topic: Topic) -> Callable[[bytes], None]:
        special = {RUN_INFO.name: self._on_run_info, STATUS.name: self._on_status}.get(topic.name)
        clear = without_padding(topic.type)

        def receive(received: bytes) -> None:
            data = clear(received)
            if special is not None and not self.finished:
                special(data)
            if self._run_id and not self.finished:
                self._take(topic.name, data)
            elif topic.latched:
                self._early[topic.name] = data

        return receive

    def _take(self, name: str, data: bytes) -> None:
        """Hold a message until its step is written."""
        step = 0 if name == LANES.name else _step(data)
        if name in OTHERS and name not in self._per_step:
            step = step if self._now - RECORDER_WINDOW <= step <= self._now + AHEAD else self._now
            step = min(max(step, 0), self._total)
            self._kept[name, step] += 1
            if self._kept[name, step] > KEPT:
                return
        elif name == AGENTS.name:
            self._now = max(self._now, min(step, self._total))
            self._repeated += step == 0
        if step > self._total:
            return  # of somebody else's clock
        held = self._pending.get(step, {}).get(name, [])
        if step < self._written:
            if name not in self._per_step or (step, name) in self._absent:
                self._absent.discard((step, name))
                self._writer.write(name, data, messages.nanoseconds(step))
            else:
                self._confirm()  # the bridge asks again
        elif held and name in self._per_step:
            self._advance()
            self._confirm()
        elif data not in held:
            self._pending.setdefault(step, {}).setdefault(name, []).append(data)
            self._advance()

    def _on_run_info(self, data: bytes) -> None:
        info: RunInfo = deserialize_message(data, RunInfo)
        if self._run_id:
            raise InputError(
                f"{RUN_INFO.name}: run {info.run_id} begins while {self._run_id} is being recorded; is there another "
                f"bridge in ROS_DOMAIN_ID {self.context.get_domain_id()}?"
            )
        self._run_id = info.run_id
        scenario = Scenario.from_yaml(info.scenario_yaml, f"{RUN_INFO.name} of run {info.run_id}")
        self._writer.add_metadata(
            "run",
            {
                "run_id": info.run_id,
                "scenario": info.scenario,
                "ego": info.ego,
                "policy": info.policy,
                "seed": str(info.seed),
                "configuration": info.configuration,
                "versions": info.versions,
            },
        )
        self._writer.attach("scenario.yaml", "application/yaml", info.scenario_yaml.encode())
        self._writer.attach("net.xml", "application/xml", scenario.net_path.read_bytes())
        self._writer.attach("recording.parquet", "application/vnd.apache.parquet", scenario.recording.to_parquet())
        self._per_step, self._total = tuple(info.topics), info.total_steps
        for name, early in self._early.items():
            self._take(name, early)
        self._unheard = set(info.stages) - {STAGE}
        self._hearing = self.create_timer(
            HEARING_S if self._unheard else 0.0, self._ready, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self.get_logger().info(f"recording run {info.run_id} to {self._writer.path}")

    def _ready(self) -> None:
        """Let the run begin."""
        self._hearing.cancel()
        if self._word is None:
            self._say(StageStatus.READY)

    def _on_hello(self, hello: Hello) -> None:
        if self._word is not None and hello.run_id == self._run_id:
            self._status.publish(self._word)

    def _on_status(self, data: bytes) -> None:
        status: StageStatus = deserialize_message(data, StageStatus)
        if status.run_id != self._run_id:
            return
        if status.state == StageStatus.READY and status.stage in self._unheard:
            self._unheard.discard(status.stage)
            if not self._unheard:
                self._ready()
        if status.stage != BRIDGE:
            return
        if status.state == StageStatus.RUNNING:
            self._missed.add(status.step)
            self._advance()
        elif status.state >= StageStatus.FINISHED and not self._ending:
            self._pending.setdefault(status.step, {}).setdefault(STATUS.name, []).append(data)
            self._ending = True
            until, seen = time.monotonic() + LINGER_S, [-1]

            def settle() -> None:
                """End once a while has passed after the last step came in: others may have said something on it."""
                if seen[0] < status.step and time.monotonic() < until:
                    seen[0] = self._now
                elif not self.finished:
                    self._end(status.state)

            self.create_timer(SETTLE_S, settle, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _end(self, state: int) -> None:
        """Close the file of a run that the bridge has ended."""
        self.close()
        if state == StageStatus.FAILED:  # it ended amid a step
            self._absent = {(step, name) for step, name in self._absent if step < self._next}
        self._say(StageStatus.FAILED if self.gaps else StageStatus.FINISHED, self.gaps)

    def _say(self, state: int, text: str = "") -> None:
        self._word = messages.status(self._run_id, STAGE, state, text=text)
        self._status.publish(self._word)

    def _complete(self, step: int) -> bool:
        held = self._pending.get(step, {})
        needed = OF_THE_BRIDGE if step in self._missed else self._per_step
        met = step > 0 or EGO_APPLIED.name not in self._per_step or self._repeated > REPEATS_MAX
        return all(name in held for name in needed) and (met or any(name in held for name in EGO_INPUT_NAMES))

    def _advance(self) -> None:
        """Confirm steps that are complete, and write those that nothing can be missing from any more."""
        before, newest = self._next, max(self._pending, default=0)
        while newest >= self._next and (
            self._complete(self._next) or newest - self._next > RECORDER_WINDOW // 2  # it will not come any more: a gap
        ):
            self._next += 1
        due = self._next // CONFIRM_EVERY > before // CONFIRM_EVERY or self._next in (1, self._total + 1)
        if self._next > before and due:
            self._confirm()
        while self._written < self._next - LAG:
            self._write(self._written)
            self._written += 1

    def _confirm(self) -> None:
        if self._next:
            self._recorded.publish(messages.status(self._run_id, STAGE, StageStatus.RUNNING, self._next - 1))

    def _write(self, step: int) -> None:
        held = self._pending.pop(step, {})
        self._absent |= {(step, name) for name in self._per_step if name not in held}
        for topic in RECORDED_TOPICS:
            for data in sorted(held.get(topic.name, [])):
                self._writer.write(topic.name, data, messages.nanoseconds(step))


def _step(data: bytes) -> int:
    return round(stamp_ns(data) / STEP_NS)


def main() -> None:
    """Entry point of ``ros2 run litsim_sim recorder``."""
    with process():
        node = RecorderNode()
        node.get_logger().info(f"waiting for a run on {RUN_INFO.name}")
        try:
            spin(node, lambda: node.finished)
        except KeyboardInterrupt as error:
            node.abandon(reason(error), SIGNAL_PERIOD)
            raise
        except Exception as error:
            node.abandon(reason(error), LINGER_S)
            raise
        until = time.monotonic() + SIGNAL_PERIOD  # the bridge may greet once more
        spin(node, lambda: time.monotonic() > until)
        if node.gaps:
            print(f"error: the recording has gaps: {node.gaps}", file=sys.stderr)
            sys.exit(1)


if __name__ == "__main__":
    main()
