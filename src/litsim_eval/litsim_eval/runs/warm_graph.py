"""A graph and a stack that stay up from run to run, in one process: for stacks that can begin anew.

The nodes are those that the launcher starts, made anew for each run beside each other in a process that has imported
everything and takes part in DDS already. Nobody has to be started, to load, or to be found by others.
"""

from __future__ import annotations

import gc
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from litsim_eval.campaign.case import Case
from litsim_eval.report.recorded import RecordedAnalysis
from litsim_eval.runs.case_run import RECORDING, plan_of
from litsim_policy.driving.stages_node import STAGES
from litsim_sim.core.errors import reason
from litsim_sim.core.stages import BRIDGE, RECORDER
from litsim_sim.kernels.garbage import without_collection
from litsim_sim.launch.child import Child
from litsim_sim.launch.domain import EMPTY, graph_domain, is_known_empty
from litsim_sim.launch.middleware import RANGE, use_middleware_settings
from litsim_sim.launch.net_check import begin_net_check
from litsim_sim.launch.nodes import GraphNode, nodes_of
from litsim_sim.launch.processes import LOG_FOLDER, STACK, Graph, ros_arguments
from litsim_sim.nodes.bridge import Bridge
from litsim_sim.nodes.bridge_node import BridgeNode
from litsim_sim.nodes.recorder import RecorderNode
from litsim_sim.nodes.responses import RunFailed
from litsim_sim.record.bag import discard_derived, make_room
from litsim_sim.record.failure import write_failure
from litsim_sim.record.seal import write_seal
from litsim_sim.ros.in_process import InProcessTransport
from litsim_sim.scenario.scenario import Scenario

COLLECT_RUNS = 20  # [runs] between two collections of garbage, of which a run leaves a MB
LOOK_S = 0.1  # [s] between two looks at the stack during a run


class WarmGraph:
    """The graph and the stack of this process, in a domain of their own; a context manager that ends the stack."""

    def __init__(self) -> None:
        self._held = ExitStack()
        self._command: list[str] = []  # of the stack that runs
        self._stack: Child | None = None
        self._runs = 0
        self._said = 0  # [B] of the stack's log, in the runs before

    def __enter__(self) -> WarmGraph:
        os.environ.pop("ROS_DOMAIN_ID", None)
        self._folder = Path(self._held.enter_context(tempfile.TemporaryDirectory(prefix="litsim-")))
        self._domain = self._held.enter_context(graph_domain(None, reserve=True))
        os.environ |= {"ROS_DOMAIN_ID": str(self._domain), RANGE: os.environ.get(RANGE, "LOCALHOST")}
        if is_known_empty(self._domain, os.environ):
            os.environ[EMPTY] = str(self._domain)
        self._starter = Graph(self._folder, self._domain)
        use_middleware_settings(BRIDGE)
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._held.callback(rclpy.try_shutdown)
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._end_stack()
        self._held.close()

    def run(self, case: Case, folder: Path) -> str:
        """Run a case into `folder`, and measure it; returns why it has failed, empty if it has not.

        A run that fails with a stack that has driven before is made again with a new one, and nothing is left of it.
        """
        has_driven = self._has(case.ego.argv)
        failure = self._attempt(case, folder)
        return self._attempt(case, folder) if failure and has_driven else failure

    def _attempt(self, case: Case, folder: Path) -> str:
        """Run a case by the stack that runs, or a new one; that of a run that fails is ended."""
        out = folder / RECORDING
        make_room(out, overwrite=True)
        (out / LOG_FOLDER).mkdir(exist_ok=True)
        with without_collection(), _logged(out / LOG_FOLDER / "graph.log"):
            failure = ""
            try:
                self._drive(case, out)
            except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
                failure = self._explained(str(error) if isinstance(error, RunFailed) else reason(error))
            if failure:
                write_failure(out, failure)
            discard_derived(out)  # which the stack may have forged
            status = RecordedAnalysis(None)(out, quiet=True, failed=bool(failure), case=folder)
        self._collect()
        self._hand_over_log(out / LOG_FOLDER / f"{STACK}.log")
        if failure or status:
            self._end_stack()
        return failure or ("the run is not valid" if status else "")

    def _collect(self) -> None:
        """Let go of what the nodes have left, now and then: a pass over all libraries takes as long as many steps."""
        self._runs += 1
        if self._runs % COLLECT_RUNS == 0:
            gc.unfreeze()
            gc.collect()
        gc.freeze()

    def _drive(self, case: Case, out: Path) -> None:
        """Make the run of a case, recorded to `out`."""
        plan = plan_of(case)
        bridge = {"ego_interface": case.ego.interface, "progress": "none"}
        nodes = nodes_of(plan, case.scenario, out, overwrite=True, **bridge)
        begin_net_check(plan.scenario.net_path)()
        self._start_stack(case.ego.argv)
        with _made({node.name: node for node in nodes}, plan.scenario) as (node, recorder):
            run = Bridge(node)
            node.create_timer(LOOK_S, self._watch(run, node), clock=Clock(clock_type=ClockType.STEADY_TIME))
            try:
                run.run()
            except BaseException as error:
                recorder.abandon(reason(error), 0.0)
                raise
        if run.facts is not None:
            write_seal(out, run.facts)

    def _start_stack(self, command: list[str]) -> None:
        """Start the stack, unless it runs already; none for LitSim's own egos."""
        if self._has(command):
            return
        self._end_stack()
        if command:
            self._starter.start_stack(command)
            self._command, self._stack, self._said = command, self._starter.children[STACK], 0

    def _has(self, command: list[str]) -> bool:
        """Returns whether the stack of a command runs."""
        return self._stack is not None and self._stack.running and self._command == command

    def _end_stack(self) -> None:
        self._starter.stop()
        if self._stack is not None:
            self._stack.log.unlink(missing_ok=True)
            self._stack = None

    def _watch(self, run: Bridge, node: BridgeNode) -> Callable[[], None]:
        """Returns what ends a run whose stack has ended."""

        def look() -> None:
            if self._stack is not None and not self._stack.running and not run.over:
                node.liveness.fail(self._stack.obituary())

        return look

    def _explained(self, why: str) -> str:
        """Returns why a run has failed, with what is known of its stack."""
        if self._stack is not None and self._stack.running:
            return why + self._starter.about_the_stack(why)
        return why

    def _hand_over_log(self, log: Path) -> None:
        """Write to `log` what the stack has said since the last run."""
        if self._stack is None:
            return
        content = self._stack.log.read_bytes()
        log.write_bytes(content[self._said :])
        self._said = len(content)


@contextmanager
def _made(nodes: Mapping[str, GraphNode], scenario: Scenario) -> Iterator[tuple[BridgeNode, RecorderNode]]:
    """Make the nodes of a run of `scenario` in this process, served with the bridge; they are gone afterwards."""
    options = {
        name: {"cli_args": ros_arguments(node.parameters), "enable_rosout": False} for name, node in nodes.items()
    }
    made: list[Node] = []
    try:
        made.append(bridge := BridgeNode(scenario, **options[BRIDGE]))
        transport = InProcessTransport(scenario)
        made.append(recorder := RecorderNode(transport, **options[RECORDER]))
        made += [make(transport, **options[name]) for name, make in STAGES.items() if name in nodes]
        bridge.serve_beside(*made[1:])
        yield bridge, recorder
    finally:
        for node in made:
            node.destroy_node()


@contextmanager
def _logged(log: Path) -> Iterator[None]:
    """Let what this process writes go to a file."""
    before = [os.dup(number) for number in (1, 2)]
    with log.open("a") as file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
    try:
        yield
    finally:
        sys.stdout.flush()
        for number, own in enumerate(before, 1):
            os.dup2(own, number)
            os.close(own)
