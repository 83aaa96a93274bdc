"""The recorder: every topic of a run to MCAP, raw CDR, in the order of the simulation."""

from __future__ import annotations

import signal
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import rclpy
from litsim_msgs.msg import Hello, RunInfo, StageStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions

from litsim_sim.bag import BagWriter, qos_yaml
from litsim_sim.errors import InputError
from litsim_sim.ros import messages
from litsim_sim.ros.definitions import definition, type_hash, type_name
from litsim_sim.ros.topics import (
    HELLO,
    RECORDED,
    RECORDED_TOPICS,
    RECORDER_WINDOW,
    RUN_INFO,
    STATUS,
    Topic,
)
from litsim_sim.scenario import Scenario

STAGE = "recorder"
CONFIRM_EVERY = 10  # steps
LAG = 2  # steps by which writing follows, so that timings, which nobody waits for, find their step
SIGNAL_PERIOD = 0.2  # [s]


class RecorderNode(Node):
    """Records one run, then :attr:`finished`.

    A step is confirmed to the bridge once each of the run's per-step topics holds it. Steps are written in order,
    their messages in the order of :data:`RECORDED_TOPICS`, so that equal runs give equal records.
    """

    def __init__(self) -> None:
        super().__init__(STAGE)
        self._output = Path(str(self.declare_parameter("output", "bags/run").value))
        overwrite = bool(self.declare_parameter("overwrite", False).value)
        self._writer = BagWriter(self._output, self._output.resolve().name, {}, overwrite=overwrite)
        self.finished = False
        self.gaps: list[str] = []
        self._run_id = ""
        self._per_step: tuple[str, ...] = ()
        self._total = 0
        self._pending: dict[int, dict[str, list[bytes]]] = {}
        self._next = 0  # step to be confirmed next
        self._written = 0  # step to be written next
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

    def _receiver(self, topic: Topic) -> Callable[[bytes], None]:
        special = {RUN_INFO.name: self._on_run_info, STATUS.name: self._on_status}.get(topic.name)

        def receive(data: bytes) -> None:
            if self.finished:
                return
            if special is not None:
                special(data)
            if not self._run_id:
                return
            step = _step(data)
            if step < self._written and topic.name not in self._per_step:
                self._writer.write(topic.name, data, messages.nanoseconds(step))
                return
            held = self._pending.setdefault(step, {}).setdefault(topic.name, [])
            if topic.name in self._per_step and (held or step < self._next):
                self._confirm()  # the bridge asks again
            elif data not in held:
                held.append(data)
                self._advance()

        return receive

    def _on_run_info(self, data: bytes) -> None:
        info: RunInfo = deserialize_message(data, RunInfo)
        if self._run_id:
            raise InputError(f"{RUN_INFO.name}: run {info.run_id} begins while {self._run_id} is being recorded")
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
        self._run_id, self._per_step, self._total = info.run_id, tuple(info.topics), info.total_steps
        self._ready()

    def _on_hello(self, hello: Hello) -> None:
        if hello.run_id == self._run_id:
            self._ready()

    def _on_status(self, data: bytes) -> None:
        status: StageStatus = deserialize_message(data, StageStatus)
        if status.stage == "bridge" and status.run_id == self._run_id and status.state >= StageStatus.FINISHED:
            self._pending.setdefault(status.step, {}).setdefault(STATUS.name, []).append(data)
            self.close()
            state = StageStatus.FAILED if self.gaps else StageStatus.FINISHED
            self._status.publish(messages.status(self._run_id, STAGE, state, text="; ".join(self.gaps)))

    def _ready(self) -> None:
        self._status.publish(messages.status(self._run_id, STAGE, StageStatus.READY))

    def _advance(self) -> None:
        """Confirm steps that are complete, and write those that nothing can be missing from any more."""
        before, newest = self._next, max(self._pending, default=0)
        while newest >= self._next and (
            all(name in self._pending.get(self._next, ()) for name in self._per_step)
            or newest - self._next > RECORDER_WINDOW // 2  # it will not come any more: a gap
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
        missing = [name for name in self._per_step if name not in held]
        if missing:
            self.gaps.append(f"step {step} holds no {', '.join(missing)}")
        for topic in RECORDED_TOPICS:
            for data in sorted(held.get(topic.name, [])):
                self._writer.write(topic.name, data, messages.nanoseconds(step))

    def close(self) -> None:
        """Write what is held, and finish the file."""
        if self.finished:
            return
        self.finished = True
        for step in range(self._written, max(self._pending, default=-1) + 1):
            self._write(step)
        self._writer.close()


def _step(data: bytes) -> int:
    """Step of a serialised message: all recorded types begin with a header, or as Clock with its stamp."""
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    return int(round((seconds * 10**9 + nanoseconds) / messages.nanoseconds(1)))


def main() -> None:
    """Entry point of ``ros2 run litsim_sim recorder``."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    node = None
    try:
        node = RecorderNode()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not node.finished:
            executor.spin_once(timeout_sec=SIGNAL_PERIOD)
        executor.spin_once(timeout_sec=SIGNAL_PERIOD)
        if node.gaps:
            print(f"error: recording has gaps: {'; '.join(node.gaps)}", file=sys.stderr)
            sys.exit(1)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        if node is not None:
            node.close()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
