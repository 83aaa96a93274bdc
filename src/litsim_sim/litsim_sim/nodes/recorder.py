"""The recorder: writes every topic of a run to MCAP, as raw CDR, in the order of the simulation."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from litsim_msgs.msg import Hello, RunInfo, StageStatus
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.timer import Timer

from litsim_sim.core.errors import EXIT_FAILED, InputError, print_error, reason
from litsim_sim.core.scene import STEP_NS
from litsim_sim.core.stages import BRIDGE, StageState
from litsim_sim.core.stages import RECORDER as STAGE
from litsim_sim.nodes.foreign_topics import LOOK_S, ForeignTopics
from litsim_sim.nodes.options import recorder_stage
from litsim_sim.nodes.publishers import Owners, Visits, owners
from litsim_sim.nodes.responses import RunFailed
from litsim_sim.record.bag import FORMAT, FORMAT_KEY, BagWriter
from litsim_sim.record.step_buffer import StepBuffer
from litsim_sim.ros import messages
from litsim_sim.ros.cdr import run_id_of, stamp_ns, without_padding
from litsim_sim.ros.endpoints import publisher_on, subscribe
from litsim_sim.ros.in_process import InProcessTransport
from litsim_sim.ros.parameters import read_parameters
from litsim_sim.ros.process import process, spin
from litsim_sim.ros.topics import (
    CLOCK,
    EGO_APPLIED,
    FOREIGN,
    HELLO,
    LANES,
    RECORDED,
    RECORDED_TOPICS,
    RUN_INFO,
    SIGNALS,
    STATUS,
    Topic,
)
from litsim_sim.scenario.run_info import EXTERNAL
from litsim_sim.scenario.scenario import Scenario

HEARING_S = 10.0  # longest wait for READY of the other stages, which holds their parameters to be recorded
SETTLE_S = 0.05  # period of the checks whether all messages of a run that is over have been received
NICENESS = 5  # gives priority to the loop where processors are scarce; the bridge waits for a recorder far behind
WAITING = 2000  # [messages] queue of a topic: those of foreign publishers must not displace those of the run
DELIVERY_S = 0.2  # longest wait for the delivery of the last messages; time to report an interruption
LINGER_S = 1.0  # longest wait for messages of a run that is over; time for which a failed recorder answers greetings


class RecorderNode(Node):
    """Records one run, then sets :attr:`finished`; a step buffer puts messages in order.

    The recorder is ready once every other stage is, or after HEARING_S. At the end of the run it reports FINISHED, or
    FAILED if the recording has gaps.
    """

    def __init__(self, transport: InProcessTransport | None = None, **options: Any) -> None:
        """Make the node, with `options` of rclpy's; `transport` holds the stages of its process, if there are any."""
        super().__init__(STAGE, automatically_declare_parameters_from_overrides=True, **options)
        chosen = read_parameters(self, recorder_stage)
        output = Path(chosen.output)
        self._transport = transport or InProcessTransport()
        self._writer = BagWriter(output, output.resolve().name, overwrite=chosen.overwrite)
        self.finished = False
        self._run_id = ""
        self._buffer: StepBuffer | None = None  # None before a run has begun
        self._newest_status: StageStatus | None = None  # state in the current run, repeated when the bridge greets
        self._unheard: set[str] = set()
        self._of_this_run: set[Topic] = set()  # topics of which messages of other runs are not recorded
        self._early: dict[Topic, bytes] = {}  # latched messages received before RunInfo
        self._with_clock = True
        self._visits = Visits(self)
        self._owners: Owners = {}  # before a run has begun
        self._ending = False
        own = {topic.name for topic in RECORDED_TOPICS}
        self._foreign = [name for name in dict.fromkeys(chosen.topics.split()) if name not in own]
        foreign = ForeignTopics(self, self._writer, self._foreign, self._take_foreign)
        if self._foreign:
            self._timer(LOOK_S, foreign.look)
        self._status = publisher_on(self, STATUS)
        self._recorded = publisher_on(self, RECORDED)
        for topic in RECORDED_TOPICS:
            subscribe(self, topic, self._receiver(topic), raw=True, depth=WAITING, matched=self._visits.of(topic))
        subscribe(self, HELLO, self._on_hello)
        for topic in RECORDED_TOPICS:  # during DDS discovery
            self._writer.add_topic(topic.described)

    @property
    def gaps(self) -> str:
        """Text that lists the gaps of the record; empty for none."""
        return "" if self._buffer is None else self._buffer.gaps

    def abandon(self, text: str, linger: float) -> None:
        """Finish the file before the run is over, and report `text` as the reason for `linger` seconds."""
        with suppress(InputError, ValueError):  # writing the file may be what failed
            self._close(amid_step=False)
        self._say(StageState.FAILED, text)
        until = time.monotonic() + linger
        spin(self, lambda: time.monotonic() > until)

    def deliver(self) -> None:
        """Wait until the bridge and all other subscribers have received the last messages."""
        self._status.wait_for_all_acked(Duration(seconds=DELIVERY_S))

    def _receiver(self, topic: Topic) -> Callable[[bytes], None]:
        special = {RUN_INFO.name: self._on_run_info, STATUS.name: self._on_status}.get(topic.name)
        clear = without_padding(topic.type)

        def receive(received: bytes) -> None:
            data = clear(received)
            if self._owners and not self.finished:
                self._visits.check(self._owners)
            if special is not None and not self.finished and not special(data):
                return
            if self._run_id and not self.finished:
                self._take(topic, data)
            elif topic.latched:
                self._early[topic] = data

        return receive

    def _take(self, topic: Topic, data: bytes) -> None:
        if topic == CLOCK and (not self._with_clock or stamp_ns(data) % STEP_NS):
            return  # of an adapter of the ego's stack, or between two steps
        if self._buffer is not None and (topic not in self._of_this_run or run_id_of(data) == self._run_id):
            self._buffer.take(topic.name, step_of(topic, data), data)

    def _take_foreign(self, name: str, data: bytes) -> None:
        """Take a message of the ego's stack, whose stamp may be of another clock: it counts for the newest step."""
        if self._buffer is not None and not self.finished:
            self._buffer.take(name, max(0, self._buffer.newest), data)

    def _on_run_info(self, data: bytes) -> bool:
        """Start to record the run; return False if another run is being recorded already."""
        info: RunInfo = deserialize_message(data, RunInfo)
        if self._run_id:
            self.get_logger().warning(
                f"{RUN_INFO.name}: run {info.run_id} is not recorded, {self._run_id} is; is there another bridge in "
                f"ROS_DOMAIN_ID {self.context.get_domain_id()}?"
            )
            return False
        self._run_id = info.run_id
        self._with_clock = CLOCK.name in info.topics
        self._owners = owners(
            info.stages,
            external=info.ego == EXTERNAL,
            applied=EGO_APPLIED.name in info.topics,
            signals=SIGNALS.name in info.topics,
        )
        describe(self._writer, info, self._transport.scenario(info))
        names = [*(topic.name for topic in RECORDED_TOPICS), *self._foreign]
        foreign = [*(topic.name for topic in FOREIGN), *self._foreign]
        self._buffer = StepBuffer(names, tuple(info.topics), foreign, info.total_steps, self._write, self._confirm)
        self._of_this_run = {topic for topic in RECORDED_TOPICS if _tells_run(topic, info)}
        for topic, early in self._early.items():
            self._take(topic, early)
        self._unheard = set(info.stages) - {STAGE}
        self._hearing = self._timer(HEARING_S if self._unheard else 0.0, self._ready)
        self.get_logger().info(f"recording run {info.run_id} to {self._writer.path}")
        return True

    def _ready(self) -> None:
        """Report READY, so that the run can begin."""
        self._hearing.cancel()
        if self._newest_status is None:
            self._say(StageState.READY)
            let_other_sessions_go_first()

    def _on_hello(self, hello: Hello) -> None:
        if self._newest_status is not None and hello.run_id == self._run_id:
            self._status.publish(self._newest_status)

    def _on_status(self, data: bytes) -> bool:
        """Take the status of a node; return that it is to be recorded, as every status is."""
        status: StageStatus = deserialize_message(data, StageStatus)
        if self._buffer is None or status.run_id != self._run_id:
            return True
        if status.state == StageState.READY and status.stage in self._unheard:
            self._unheard.discard(status.stage)
            if not self._unheard:
                self._ready()
        if status.stage == BRIDGE and status.state == StageState.RUNNING:
            self._buffer.go_on(status.step)
        elif status.stage == BRIDGE and status.state == StageState.ENDING:
            self._buffer.end_at(status.step)
        elif status.stage == BRIDGE and not self._ending:
            self._ending = True
            self._settle(self._buffer, status)
        return True

    def _settle(self, buffer: StepBuffer, status: StageStatus) -> None:
        """End the recording SETTLE_S after the last step has been received, so that other messages on it are recorded.

        After a finished run all of that step has been received, unless the bridge waited for another recorder; the
        recording then ends after LINGER_S.
        """
        until, newest = time.monotonic() + LINGER_S, -1
        failed = status.state == StageState.FAILED

        def look() -> None:
            nonlocal newest
            if newest < status.step and time.monotonic() < until:
                newest = buffer.newest if failed else buffer.confirmed
            elif not self.finished:
                self._close(amid_step=failed)
                self._say(StageState.FAILED if self.gaps else StageState.FINISHED, self.gaps)

        self._timer(SETTLE_S, look)

    def _close(self, *, amid_step: bool) -> None:
        """Write the buffered messages, and finish the file."""
        if self.finished:
            return
        self.finished = True
        if self._buffer is not None:
            self._buffer.end(amid_step=amid_step)
        self._writer.close()

    def _say(self, state: StageState, text: str = "") -> None:
        self._newest_status = messages.status(self._run_id, STAGE, state, text=text)
        self._status.publish(self._newest_status)

    def _confirm(self, step: int) -> None:
        self._recorded.publish(messages.status(self._run_id, STAGE, StageState.RUNNING, step))

    def _write(self, name: str, data: bytes, step: int) -> None:
        self._writer.write(name, data, step * STEP_NS)

    def _timer(self, period_s: float, callback: Callable[[], None]) -> Timer:
        """Returns a timer of the wall clock, independent of simulation time."""
        return self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def _tells_run(topic: Topic, info: RunInfo) -> bool:
    """Returns whether only LitSim publishes on `topic` in the run of `info`, and each message names its run.

    Messages on /litsim/status are recorded whichever run they name.
    """
    ours = topic not in FOREIGN or topic.name in info.topics
    return ours and topic not in (RUN_INFO, STATUS) and "run_id" in topic.type.get_fields_and_field_types()


def describe(writer: BagWriter, info: RunInfo, scenario: Scenario) -> None:
    """Write the description of a run and its `scenario` to a bag, with all files needed to repeat it."""
    fields = ("run_id", "scenario", "ego", "policy", "seed", "configuration", "versions")
    writer.add_metadata("run", {FORMAT_KEY: str(FORMAT)} | {name: str(getattr(info, name)) for name in fields})
    writer.attach("scenario.yaml", "application/yaml", info.scenario_yaml.encode())
    writer.attach("net.xml", "application/xml", scenario.net_path.read_bytes())
    writer.attach("recording.parquet", "application/vnd.apache.parquet", scenario.recording.parquet)


def step_of(topic: Topic, data: bytes) -> int:
    """Returns the step of a serialised message of a recorded topic, by its stamp; 0 for the lanes, which have none."""
    return 0 if topic == LANES else round(stamp_ns(data) / STEP_NS)


def let_other_sessions_go_first() -> None:
    """Lower the priority of this process's session, if it has its own; to be called when the run begins.

    Linux shares processors between sessions first, each by a niceness of its own. Without this a step takes 1.54 times
    as long on a busy machine (0.95 to 1.78, 5 pairs).
    """
    if os.getsid(0) == os.getpid():
        with suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(NICENESS))


def main() -> None:
    """Entry point of ``ros2 run litsim_sim recorder``."""
    os.nice(NICENESS)  # before threads are started, which inherit it
    with process():
        node = RecorderNode()
        node.get_logger().info(f"waiting for a run on {RUN_INFO.name}")
        try:
            spin(node, lambda: node.finished)
        except KeyboardInterrupt as error:
            node.abandon(reason(error), DELIVERY_S)
            raise
        except RunFailed as error:
            node.abandon(str(error), LINGER_S)
            print_error(error)
            sys.exit(EXIT_FAILED)
        except Exception as error:
            node.abandon(reason(error), LINGER_S)
            raise
        node.deliver()
        if node.gaps:
            print_error(f"the recording has gaps: {node.gaps}")
            sys.exit(EXIT_FAILED)
