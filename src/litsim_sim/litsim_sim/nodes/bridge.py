"""The bridge: steps the world, publishes every step, and waits for the answers to it."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from typing import Any

from litsim_msgs.msg import Hello, StageStatus
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

from litsim_sim.core.errors import EXIT_FAILED, print_error, reason
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.core.stages import BRIDGE, StageState
from litsim_sim.ego_port.answer import Interface
from litsim_sim.ego_port.port import EgoPort, Level, Remark
from litsim_sim.kernels.compiled import load_kernels
from litsim_sim.launch.domain import held_domain
from litsim_sim.launch.domain_ports import EMPTY
from litsim_sim.nodes import diagnostics
from litsim_sim.nodes.bridge_options import BridgeOptions, bridge_stage
from litsim_sim.nodes.broadcast import PUBLISHED, PUBLISHED_OF_SIGNALS, Broadcast, run_info
from litsim_sim.nodes.diagnostics import Diagnostics
from litsim_sim.nodes.responses import (
    EgoPublisher,
    EgoPublishers,
    ResponseCollector,
    RunFailed,
    StageLiveness,
    absence,
    rivalry,
)
from litsim_sim.nodes.run_loop import Pulse, RunLoop
from litsim_sim.ros import ego_port, messages, standard
from litsim_sim.ros.definitions import type_name
from litsim_sim.ros.endpoints import Endpoints, node_of, publisher_on, subscribe
from litsim_sim.ros.parameters import parameters, read_parameters
from litsim_sim.ros.process import executor_of, process, serve, spare_from_collection
from litsim_sim.ros.topics import (
    CONTROLS,
    DIAGNOSTICS,
    EGO_APPLIED,
    EGO_INPUTS,
    FRAMES,
    HELLO,
    RECORDED,
    RUN_INFO,
    STATUS,
    TIMING,
    Topic,
)
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan
from litsim_sim.world.world import World, WorldConfig

NOTE_PERIOD = 5.0  # [s] period of repeated lines in the log
NAMES_S = 1.0  # [s] by which the names of nodes may follow their publishers, at most
ENDED = {StageState.FINISHED: diagnostics.FINISHED, StageState.FAILED: diagnostics.FAILED}


class BridgeNode(Node):
    """Implements :class:`litsim_sim.nodes.run_loop.Graph`; :meth:`run` runs one run."""

    declared = Endpoints(
        BRIDGE,
        (HELLO, STATUS, TIMING, EGO_APPLIED, DIAGNOSTICS, *PUBLISHED, *PUBLISHED_OF_SIGNALS, *FRAMES),
        (*EGO_INPUTS.values(), CONTROLS, STATUS, RECORDED, HELLO, RUN_INFO, TIMING),
    )

    def __init__(self) -> None:
        super().__init__(BRIDGE, automatically_declare_parameters_from_overrides=True)
        self.since = time.perf_counter()
        self.options = options = read_parameters(self, bridge_stage)
        plan = self.plan = options.plan()
        self._liveness = StageLiveness(plan.run_id, plan.stages)
        self._port = port_of(options, plan)
        self._responses = ResponseCollector(
            self._port,
            self._liveness,
            messages.controls_from_message,
            run_id=plan.run_id,
            ego_id=plan.scenario.ego_id,
            with_policy=plan.policy != "replay",
            stop_on_missing=options.mode == "lockstep" and options.on_missing == "stop",
        )
        self._noted = ("", 0.0)
        self._pulse = Pulse(options.progress == "lines")
        self._ego_nodes: list[str] = []
        self._publishers_of_ego = EgoPublishers()
        self._to_meet = True  # whether a publisher of the ego may have come since they were last noted
        external = plan.ego == EXTERNAL
        published = (HELLO, STATUS, TIMING, *((EGO_APPLIED,) if external else ()))
        self._to = {t: publisher_on(self, t) for t in published}
        self._broadcast = Broadcast(self, plan, clock=options.clock, factor=options.real_time_factor)
        self._diagnostics = Diagnostics(self, plan.run_id, plan.scenario.total_steps, self._port)
        ego_port.subscribe(self, self._port, tuple(Interface) if external else (Interface.CONTROL,))
        if plan.policy != "replay":
            self._listen(CONTROLS, lambda m: self._responses.offer_controls(m.run_id, m.step, m))
        self._listen(STATUS, lambda m: self._liveness.take_status(m.run_id, m.stage, m.state, m.text))
        self._listen(RECORDED, lambda m: self._liveness.take_confirmation(m.run_id, m.step))
        for topic in (HELLO, RUN_INFO):
            self._listen(topic, lambda m: self._liveness.take_run(m.run_id))
        self._executor = executor_of(self)

    def run(self) -> None:
        """Run; return when the run is over and recorded.

        Raises:
            RunFailed: a stage failed or did not answer; all stages have been told.
        """
        loop = RunLoop(self, self.plan, self.options, self._set_up, self._port, self._liveness, self._responses)
        try:
            loop.run()
        except BaseException as error:
            text = str(error) if isinstance(error, RunFailed) else reason(error)
            self._pulse.fail()
            self.say(StageState.FAILED, self._responses.step, text=text)
            loop.farewell()
            raise

    def _set_up(self) -> World:
        """The world of the run, with its mirror and kernels."""
        from litsim_sim.world.sumo import SumoMirror  # imported here so that the stages know of the run first

        scenario = self.plan.scenario
        mirror = SumoMirror(scenario.net_path, scenario.seed, scenario.signals)
        world = World(scenario, WorldConfig(guard_entries=self.plan.policy != "replay"), mirror)
        load_kernels()
        spare_from_collection()
        return world

    @property
    def alone(self) -> bool:
        return os.environ.get(EMPTY) == str(self.context.get_domain_id())

    @property
    def domain(self) -> str:
        return f"ROS_DOMAIN_ID {self.context.get_domain_id()}"

    def begin(self) -> None:
        info = run_info(self.plan, self.options.mode, {BRIDGE: parameters(self)}, clock=self.options.clock)
        self._broadcast.begin(info)
        if self.plan.ego == EXTERNAL and (text := standard.rounding(self.plan.scenario.log.table(0))):
            self._pulse.note(text)
            self._port.remarks.append(Remark(0, Level.WARN, text))

    def greet(self) -> None:
        self._to[HELLO].publish(Hello(header=messages.header(0), run_id=self.plan.run_id))

    def show(self, table: AgentTable) -> None:
        self._broadcast.show(table)

    def accompany(self, table: AgentTable) -> None:
        self._broadcast.accompany(table)
        self._diagnostics.step(table.step)

    def show_again(self) -> None:
        if self._responses.step == 0 and self._ego_nodes:  # a stack is there that may need time to pass for its answer
            self._broadcast.creep()
        self._broadcast.repeat()
        self._diagnostics.step(self._responses.step)

    def apply(self, command: EgoCommand) -> None:
        if EGO_APPLIED in self._to:
            if self._to_meet or not self._ego_nodes:
                self.meet_ego()
            self._to[EGO_APPLIED].publish(messages.ego_to_message(command, self.plan.run_id))

    def report_time(self, step: int, compute_time: float, marks: str) -> None:
        self._to[TIMING].publish(self._status(StageState.RUNNING, step, compute_time, marks))

    def say(self, state: StageState, step: int, compute_time: float = 0.0, text: str = "") -> None:
        level = Level.WARN if state == StageState.RUNNING else Level.OK
        self._diagnostics.say(step, ENDED.get(state, diagnostics.RUNNING), level, text)
        self._to[STATUS].publish(self._status(state, max(0, step), compute_time, text))

    def ask_around(self) -> None:
        self._listen(TIMING, lambda m: self._liveness.take_timing(m.run_id, m.stage, m.step))

    def waiting(self, step: int, text: str) -> None:
        about = self.silent_ego() if EGO_APPLIED in self._to else ""  # which also remembers the ego's nodes
        self._to_meet = True
        self.note(f"step {step}: {text}" + (f": {about}" if about and step == 0 and self._port.missing else ""))
        self._diagnostics.say(step, diagnostics.RUNNING, Level.WARN, text)

    def note(self, text: str) -> None:
        last, when = self._noted
        if text != last or time.monotonic() > when + NOTE_PERIOD:
            if text == last:
                self._pulse.note(text)
            self._noted = (text, time.monotonic())
            self.get_logger().info(text)

    def meet_ego(self) -> None:
        for text in self._publishers_of_ego.note(self._port, self._ego_publishers(), self._ego_nodes):
            self._port.remarks.append(Remark(self._responses.step, Level.WARN, text))
            self._pulse.note(text)
        self._diagnostics.remarks(self._responses.step)
        self._to_meet = not self._publishers_of_ego.met

    def silent_ego(self) -> str:
        there = self._ego_publishers()
        return absence(self._port, there, self._ego_nodes, self.domain, clock=self.options.clock)

    def serve_until(self, done: Callable[[], bool], until: float) -> bool:
        while not done():
            self._pulse.beat(self._responses.step)
            now = time.perf_counter()
            if now >= until:
                return False
            serve(self._executor, min(until - now, self._broadcast.tick(now)))
            if self._port.remarks:
                self._diagnostics.remarks(self._responses.step)
                if EGO_APPLIED in self._to and (rivals := rivalry(self._port, self._ego_publishers())):
                    raise RunFailed(rivalry(self._port, self._named_ego_publishers()) or rivals)  # one may have gone
            self._liveness.check()
        return True

    def serve(self) -> None:
        self._pulse.beat(self._responses.step)
        serve(self._executor)

    def _ego_publishers(self) -> list[EgoPublisher]:
        """The announced publishers on the ego port's topics; the names of their nodes are remembered."""
        found = [
            EgoPublisher(topic.name, node_of(info), _unheard(topic, info), bytes(info.endpoint_gid))
            for topic in EGO_INPUTS.values()
            for info in self.get_publishers_info_by_topic(self.resolve_topic_name(topic.name))
        ]
        self._ego_nodes = list(dict.fromkeys(each.node for each in found if each.node)) or self._ego_nodes
        return found

    def _named_ego_publishers(self) -> list[EgoPublisher]:
        """The announced publishers on the ego port's topics, as soon as the names of all their nodes are known."""
        found, give_up = self._ego_publishers(), time.perf_counter() + NAMES_S
        while not all(each.node for each in found) and time.perf_counter() < give_up:
            time.sleep(0.01)
            found = self._ego_publishers()
        return found

    def _listen(self, topic: Topic, receive: Callable[[Any], None]) -> None:
        subscribe(self, topic, receive)

    def _status(self, state: StageState, step: int, compute_time: float = 0.0, text: str = "") -> StageStatus:
        return messages.status(self.plan.run_id, BRIDGE, state, step, compute_time, text)


def _unheard(topic: Topic, info: Any) -> str:
    """Text that says why a publisher on an input of the ego port cannot be heard; empty if it can."""
    if info.topic_type != (expected := type_name(topic.type)):
        return f"has type {info.topic_type} and cannot be heard, expected {expected}"
    if info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
        return "is BEST_EFFORT and cannot be heard, expected RELIABLE"
    return ""


def port_of(options: BridgeOptions, plan: RunPlan) -> EgoPort:
    """The port for the ego's answers: over any interface for an external ego, else commands only."""
    interface = options.ego_interface if plan.ego == EXTERNAL else Interface.CONTROL
    return EgoPort(plan.run_id, plan.scenario.vehicle, interface, stop_on_invalid=options.on_invalid == "stop")


def main() -> None:
    """Entry point of ``ros2 run litsim_sim bridge``."""
    with process():
        try:
            node = BridgeNode()
            with held_domain(node.context.get_domain_id()):
                node.run()
        except RunFailed as error:
            print_error(error)
            sys.exit(EXIT_FAILED)


if __name__ == "__main__":
    main()
