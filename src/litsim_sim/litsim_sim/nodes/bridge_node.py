"""The node of the bridge: publishes every step, and takes the answers to it."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import yaml
from litsim_msgs.msg import Hello, StageStatus
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

from litsim_sim.core.lockstep import unanswered
from litsim_sim.core.scene import AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import BRIDGE, StageState
from litsim_sim.core.topic_names import Interface
from litsim_sim.ego_port.port import EgoPort, Level, Remark
from litsim_sim.launch.domain import EMPTY
from litsim_sim.nodes import diagnostics
from litsim_sim.nodes.broadcast import Broadcast, run_info
from litsim_sim.nodes.diagnostics import Diagnostics
from litsim_sim.nodes.ego_publishers import EgoPublisher, EgoPublishers, absence, rivalry
from litsim_sim.nodes.options import bridge_stage
from litsim_sim.nodes.publishers import WATCH_S, Visits, check_publishers, owners
from litsim_sim.nodes.responses import ResponseCollector, RunFailed, StageLiveness
from litsim_sim.nodes.simulation_services import NAMESPACE, SimulationServices
from litsim_sim.record.seal import RunFacts
from litsim_sim.ros import ego_port, messages, standard
from litsim_sim.ros.definitions import type_name
from litsim_sim.ros.endpoints import node_of, once_named, publisher_on, subscribe
from litsim_sim.ros.parameters import parameters, read_parameters
from litsim_sim.ros.process import executor_of, serve
from litsim_sim.ros.topics import (
    CONTROLS,
    EGO_APPLIED,
    EGO_INPUTS,
    HELLO,
    RECORDED,
    RUN_INFO,
    STATUS,
    TIMING,
    Topic,
)
from litsim_sim.scenario.run_info import EXTERNAL
from litsim_sim.scenario.scenario import Scenario

PULSE_S = 1.0  # [s] period of signs of life
PAUSE_S = 3600.0  # [s] longest pause, after which the run ends: whoever has asked for it may be gone
NOTE_PERIOD = 5.0  # [s] period of repeated lines in the log
ENDED = {StageState.FINISHED: diagnostics.FINISHED, StageState.FAILED: diagnostics.FAILED}


class BridgeNode(Node):
    """What the bridge of one run says and hears, for :class:`litsim_sim.nodes.bridge.Bridge`.

    Attributes:
        since: time of the performance counter since which this node listens [s].
        options: parameters of the node.
        plan: the run.
        liveness: states of the other stages.
        port: port of the ego.
        responses: answers to the current step.
        pulse: lines for the launcher.
    """

    def __init__(self, scenario: Scenario | None = None, **options: Any) -> None:
        """Make the node, with `options` of rclpy's; `scenario` is that of its parameters, if it is loaded already."""
        super().__init__(BRIDGE, automatically_declare_parameters_from_overrides=True, **options)
        self.since = time.perf_counter()
        self.options = chosen = read_parameters(self, bridge_stage)
        plan = self.plan = chosen.plan(scenario)
        self.liveness = StageLiveness(plan.run_id, plan.stages)
        external = plan.ego == EXTERNAL
        interface = chosen.ego_interface if external else Interface.CONTROL
        stop_on_invalid = chosen.on_invalid == "stop"
        self.port = EgoPort(
            *(plan.run_id, plan.scenario.vehicle, interface), stop_on_invalid=stop_on_invalid, latency=plan.latency
        )
        self.responses = ResponseCollector(
            self.port,
            self.liveness,
            ControlTable.of_message,
            run_id=plan.run_id,
            ego_id=plan.scenario.ego_id,
            with_policy=plan.policy != "replay",
            stop_on_missing=chosen.mode == "lockstep" and chosen.on_missing == "stop",
        )
        self._noted = ("", 0.0)
        self.pulse = Pulse(chosen.progress == "lines")
        self._ego_nodes: list[str] = []
        self._known_ego_publishers = EgoPublishers()
        self._ego_publishers_changed = True  # whether a publisher of the ego may have come since they were last noted
        self._owners = owners(
            plan.stages, external=external, applied=plan.applied, signals=plan.scenario.signals is not None
        )
        self._watched = -WATCH_S
        self._visits = Visits(self)
        self.watch_marks: dict[str, float] = {}  # marks of the last check of publishers, until they are reported
        published = (HELLO, STATUS, TIMING, *((EGO_APPLIED,) if plan.applied else ()))
        self._outputs = {t: publisher_on(self, t) for t in published}
        self._broadcast = Broadcast(self, plan, clock=chosen.clock, factor=chosen.real_time_factor)
        self._diagnostics = Diagnostics(self, plan.run_id, plan.scenario.total_steps, self.port)
        ego_port.subscribe(self, self.port, tuple(Interface) if external else (Interface.CONTROL,))
        if plan.policy != "replay":
            self._subscribe(CONTROLS, lambda m: self.responses.offer_controls(m.run_id, m.step, m))
        self._subscribe(STATUS, lambda m: self.liveness.take_status(m.run_id, m.stage, m.state, m.text))
        self._subscribe(RECORDED, lambda m: self.liveness.take_confirmation(m.run_id, m.step))
        for topic in (HELLO, RUN_INFO):
            self._subscribe(topic, lambda m: self.liveness.take_run(m.run_id))
        self._simulation = SimulationServices.on(self, plan, served=chosen.served)
        self._told_of_pause = False
        self._executor = executor_of(self)

    def _subscribe(self, topic: Topic, receive: Callable[[Any], None]) -> None:
        """Hear a topic, and notice whoever comes to publish there."""
        subscribe(self, topic, receive, matched=self._visits.of(topic))

    @property
    def alone(self) -> bool:
        """Whether it is known without listening that there was no other run at the start."""
        return os.environ.get(EMPTY) == str(self.context.get_domain_id())

    @property
    def domain(self) -> str:
        """Description of the domain of this graph."""
        return f"ROS_DOMAIN_ID {self.context.get_domain_id()}"

    def begin(self) -> None:
        """Publish the messages for the whole run."""
        info = run_info(self.plan, self.options.mode, {BRIDGE: parameters(self)}, clock=self.options.clock)
        self._broadcast.begin(info)
        if self.plan.ego == EXTERNAL and (text := standard.rounding(self.plan.scenario.log.table(0))):
            self.pulse.say("note", text)
            self.port.remarks.append(Remark(0, Level.WARN, text))

    def greet(self) -> None:
        """Ask all stages to report their state again."""
        self._outputs[HELLO].publish(Hello(header=messages.header(0), run_id=self.plan.run_id))

    def show(self, table: AgentTable) -> None:
        """Publish a step: what the stages wait for."""
        self._broadcast.show(table)
        if self._simulation:
            self._simulation.show(table)

    def hold(self) -> None:
        """Wait as long as the run is paused, of which the user is told; raises RunFailed after PAUSE_S."""
        simulation = self._simulation
        if simulation is None:
            return
        if simulation.paused and not self._told_of_pause:
            self.pulse.say("note", f"paused at step {self.responses.step}, as a client of {NAMESPACE} has asked")
        self._told_of_pause = simulation.paused
        if not self.serve_until(simulation.next_step, time.perf_counter() + PAUSE_S):
            raise RunFailed(f"paused by a client for {PAUSE_S:g} s, and nobody lets the run go on")

    def accompany(self, table: AgentTable) -> None:
        """Publish the other messages of the last step shown: clock, state of the ego, standard types, diagnostics."""
        self._broadcast.accompany(table)
        self._diagnostics.step(table.step)

    def show_again(self) -> None:
        """Publish the last step shown again."""
        if self.responses.step == 0 and self._ego_nodes:  # a stack is there that may need time to pass for its answer
            self._broadcast.creep()
        self._broadcast.repeat()
        self._diagnostics.step(self.responses.step)

    def apply(self, command: EgoCommand) -> None:
        """Publish the command that became of an answer of the ego, if it is another one."""
        if EGO_APPLIED in self._outputs:
            if self.plan.ego == EXTERNAL and (self._ego_publishers_changed or not self._ego_nodes):
                self.note_ego_publishers()
            self._outputs[EGO_APPLIED].publish(messages.ego_to_message(command, self.plan.run_id))

    def report_time(self, step: int, compute_time: float, marks: str) -> None:
        """Publish the compute time of the bridge for a step [s], and its marks."""
        self._outputs[TIMING].publish(self._status(StageState.RUNNING, step, compute_time, marks))

    def say(self, state: StageState, step: int, compute_time: float = 0.0, text: str = "") -> None:
        """Publish the state of the run."""
        level = Level.WARN if state == StageState.RUNNING else Level.OK
        self._diagnostics.say(step, ENDED.get(state, diagnostics.RUNNING), level, text)
        self._outputs[STATUS].publish(self._status(state, max(0, step), compute_time, text))

    def end_services(self) -> None:
        """Tell those who wait for steps that there are no more."""
        if self._simulation:
            self._simulation.close()

    def finish(self, step: int, wall_s: float, summary: dict[str, Any], digest: str) -> RunFacts:
        """Report the end of the run after `step`, which took `wall_s` since step 0, with its `summary`; return all."""
        facts = RunFacts(self.plan.run_id, step, digest, wall_s, yaml.safe_dump(summary, sort_keys=False))
        if flaws := unanswered(summary):
            self.pulse.say("invalid", "; ".join(flaws))
        self.say(StageState.FINISHED, step, wall_s, facts.summary)
        return facts

    def listen_to_timings(self) -> None:
        """Start to listen to timings, to find out which stages have answered; not done by default as it costs time."""
        subscribe(self, TIMING, lambda m: self.liveness.take_timing(m.run_id, m.stage, m.step))

    def waiting(self, step: int, text: str) -> None:
        """Report to the user and to the ego's driver what a step waits for."""
        about = self.silent_ego() if self.plan.ego == EXTERNAL else ""  # which also remembers the ego's nodes
        self._ego_publishers_changed = True
        self.note(f"step {step}: {text}" + (f": {about}" if about and step == 0 and self.port.missing else ""))
        self._diagnostics.say(step, diagnostics.RUNNING, Level.WARN, text)

    def note(self, text: str) -> None:
        """Report the state of the run to the user; repeated texts are throttled."""
        last, when = self._noted
        if text != last or time.monotonic() > when + NOTE_PERIOD:
            if text == last:
                self.pulse.say("note", text)
            self._noted = (text, time.monotonic())
            self.get_logger().info(text)

    def check_publishers(self) -> None:
        """Raise RunFailed if somebody else publishes on the graph's internal topics."""
        self._watched, begin = time.monotonic(), time.perf_counter()
        check_publishers(self, self._owners)
        self.watch_marks = {"watch": begin, "watched": time.perf_counter()}

    def note_ego_publishers(self) -> None:
        """Report publishers of an external ego that were not there at step 0, which they have answered now."""
        for text in self._known_ego_publishers.note(self.port, self._ego_publishers(), self._ego_nodes):
            self.port.remarks.append(Remark(self.responses.step, Level.WARN, text))
            self.pulse.say("note", text)
        self._diagnostics.remarks(self.responses.step)
        self._ego_publishers_changed = not self._known_ego_publishers.any_known

    def silent_ego(self) -> str:
        """Returns a text that says why an external ego has not answered the current step."""
        publishers = self._ego_publishers()  # which also remembers the names of their nodes
        return absence(self.port, publishers, self._ego_nodes, self.domain, clock=self.options.clock)

    def serve_until(self, done: Callable[[], bool], until: float) -> bool:
        """Serve messages until `done()`, or until time `until` of the performance counter; return `done()`.

        Raises:
            RunFailed: a stage has failed, several stacks answer for the ego, or somebody else publishes for a stage.
        """
        while not done():
            self.pulse.beat(self.responses.step)
            now = time.perf_counter()
            if now >= until:
                return False
            serve(self._executor, min(until - now, self._broadcast.tick(now)))
            if self.port.remarks:
                self._diagnostics.remarks(self.responses.step)
                if self.plan.ego == EXTERNAL and (rivals := rivalry(self.port, self._ego_publishers())):
                    named = once_named(self._ego_publishers, attrgetter("node"))
                    raise RunFailed(rivalry(self.port, named) or rivals)  # one may have gone
            self.liveness.check()
            self._visits.check(self._owners)
            if time.monotonic() > self._watched + WATCH_S:
                self.check_publishers()
        return True

    def destroy_node(self) -> None:
        """See :class:`rclpy.node.Node`; nothing is served any more."""
        self._executor.shutdown()
        super().destroy_node()

    def serve_beside(self, *nodes: Node) -> None:
        """Serve `nodes` of the same process whenever this one is served."""
        for node in nodes:
            self._executor.add_node(node)

    def serve(self) -> None:
        """Serve a message, or wait for one for a short time."""
        self.pulse.beat(self.responses.step)
        serve(self._executor)

    def _ego_publishers(self) -> list[EgoPublisher]:
        """Returns the announced publishers on the ego port's topics; the names of their nodes are remembered."""
        publishers = [
            EgoPublisher(topic.name, node_of(info), unheard(topic, info), bytes(info.endpoint_gid))
            for topic in EGO_INPUTS.values()
            for info in self.get_publishers_info_by_topic(self.resolve_topic_name(topic.name))
        ]
        nodes = (publisher.node for publisher in publishers)
        self._ego_nodes = list(dict.fromkeys(filter(None, nodes))) or self._ego_nodes
        return publishers

    def _status(self, state: StageState, step: int, compute_time: float = 0.0, text: str = "") -> StageStatus:
        return messages.status(self.plan.run_id, BRIDGE, state, step, compute_time, text)


def unheard(topic: Topic, info: Any) -> str:
    """Returns a text that says why a publisher on an input of the ego port cannot be heard; empty if it can."""
    if info.topic_type != (expected := type_name(topic.type)):
        return f"has type {info.topic_type} and cannot be heard, expected {expected}"
    if info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
        return "is BEST_EFFORT and cannot be heard, expected RELIABLE"
    return ""


class Pulse:
    """Lines for the launcher on standard output: signs of life, also while a run waits, and what it is to know."""

    def __init__(self, wanted: bool) -> None:
        self._wanted, self._last = wanted, -math.inf

    def beat(self, step: int) -> None:
        """Print a sign of life unless one was printed recently; `step` is the current one."""
        if time.monotonic() >= self._last + PULSE_S:
            self._last = time.monotonic()
            self.say("alive", f"at step {max(0, step)}")

    def say(self, word: str, text: str) -> None:
        """Print a line, as :class:`litsim_sim.launch.processes.Progress` reads it by its first `word`."""
        if self._wanted:
            print(word, text, flush=True)
