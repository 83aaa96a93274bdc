"""A run with a stack at the ego port: the bridge and the recorder of every run, the stack, and a bystander."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from litsim_eval.analysis.measures.identity import digest
from litsim_eval.check_ads.bystander import Bystander
from litsim_eval.check_ads.trace import FAILED, FINISHED, Ending, Evidence
from litsim_sim.core.errors import InputError
from litsim_sim.core.stages import BRIDGE, RECORDER
from litsim_sim.ego_port.port import ego_state
from litsim_sim.ego_port.tracking import EgoState
from litsim_sim.launch.child import Child
from litsim_sim.launch.nodes import find_executable, program_of
from litsim_sim.launch.processes import STACK, Graph, GraphFailed
from litsim_sim.nodes.publishers import owners
from litsim_sim.record.run import read_run
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan
from litsim_sim.scenario.scenario import Scenario

TICK_S = 0.1  # [s] between two looks at the graph
LEASE_S = 25.0  # [s] within which DDS notices that a process was killed
MEETING_S = 60.0  # [s] for the bystander to find the bridge, which starts slowly on a busy machine
LAZY_S = 5.0  # [s] for a stack that creates its publisher only for its first answer


@dataclass(frozen=True)
class Check:
    """Settings of a check.

    Attributes:
        scenario: of the run.
        out: folder of its record.
        domain_id: of the graph.
        command: starts the stack; empty if the stack is started elsewhere.
        wait_s: time to wait for a publisher, and then for the answer to step 0 [s].
        answer_timeout_s: timeout of every later answer [s].
        end_wait_s: time for which the stack is watched after the run [s].
        warm: whether the stack is to drive a second run.
    """

    scenario: Scenario
    out: Path
    domain_id: int
    command: Sequence[str] = ()
    wait_s: float = 30.0
    answer_timeout_s: float = 5.0
    end_wait_s: float = 5.0
    warm: bool = False


def observe(check: Check) -> Evidence:
    """Makes the run, to its end or as far as the stack allows.

    Raises:
        InputError: the command cannot be started, or the workspace is not complete.
    """
    plan = RunPlan(check.scenario, EXTERNAL, "replay")
    nodes = {name: find_executable(*program_of(name)) for name in (RECORDER, BRIDGE)}
    graph = Graph(check.out, check.domain_id, check.answer_timeout_s)
    file = check.out / "scenario.yaml"
    file.write_text(check.scenario.to_yaml(), encoding="utf-8")
    starter = Graph(check.out, check.domain_id)  # of the stack alone, which outlives the run
    stack: Child | None = None
    internal = owners(plan.stages, external=True, applied=True, signals=check.scenario.signals is not None)
    evidence = Evidence(check.scenario, check.wait_s)
    with Bystander(check.domain_id, internal, evidence) as bystander:
        try:
            graph.start(BRIDGE, nodes[BRIDGE], _bridge(check, plan, file))
            _meet(graph.children[BRIDGE], bystander)
            if check.command:
                starter.start_stack(check.command)
                stack = starter.children[STACK]
            _discover(evidence, bystander, stack)
            graph.start(RECORDER, nodes[RECORDER], {"output": str(check.out), "overwrite": True})
            evidence.left = _follow(graph.children[BRIDGE], bystander, stack, evidence)
            evidence.failure = _failure(graph, evidence.left)
            _watch_end(check, bystander, stack, evidence)
            if check.warm and not evidence.failure:
                evidence.difference = _second_run(check, nodes, _bridge(check, plan, file))
        finally:
            graph.stop()
            starter.stop()
    evidence.states = _states(check)
    return evidence


def _bridge(check: Check, plan: RunPlan, file: Path) -> dict[str, object]:
    """Returns parameters of the bridge: invalid answers are counted, and only missing ones end the run."""
    return {
        "scenario": str(file),
        "ego": plan.ego,
        "policy": plan.policy,
        "on_missing": "stop",
        "on_invalid": "hold",
        "answer_timeout_s": check.answer_timeout_s,
        "external_timeout_s": check.wait_s,
        "handshake_timeout_s": check.wait_s + 2.0 * MEETING_S,  # the recorder is started last
        "progress": "none",
    }


def _meet(bridge: Child, bystander: Bystander) -> None:
    """Waits until the bystander hears the bridge, which itself waits for the recorder, so that no step is missed.

    Raises:
        InputError: the bridge has ended, or is not discovered.
    """
    until = time.monotonic() + MEETING_S
    while not bystander.hears_bridge:
        if not bridge.running:
            raise InputError(f"the bridge has not started: {bridge.obituary()}")
        if time.monotonic() > until:
            raise InputError(f"the bridge was not discovered within {MEETING_S:g} s; is DDS blocked on this machine?")
        bystander.listen(TICK_S)
    bystander.listen(3 * TICK_S)  # for the bridge to find the bystander, too


def _discover(evidence: Evidence, bystander: Bystander, stack: Child | None) -> None:
    """Waits for a publisher of the stack; the run has not begun yet, so its answers are heard from step 0 on."""
    bystander.start()
    until = time.monotonic() + evidence.wait_s
    while not evidence.discovered_s and time.monotonic() < until and (stack is None or stack.running):
        bystander.listen(TICK_S)
    if evidence.discovered_s:
        bystander.listen(3 * TICK_S)  # for the stack to find the bystander, too


def _follow(bridge: Child, bystander: Bystander, stack: Child | None, evidence: Evidence) -> int | None:
    """Listens until the bridge ends, the stack leaves or none is found; returns the step at which it left, or None."""
    hopeless = time.monotonic() + LAZY_S
    while bridge.running:
        bystander.listen(TICK_S)
        if not evidence.discovered_s and time.monotonic() > hopeless:
            break
        gone = (stack is not None and not stack.running) or (bool(evidence.discovered_s) and not bystander.present)
        if gone and not evidence.over:
            bystander.listen(5 * TICK_S)  # the stack may have heard of the end of the run before this program
            if not evidence.over:
                return evidence.newest
    bystander.listen(TICK_S)
    return None


def _failure(graph: Graph, left: int | None) -> str:
    """Returns why the run failed; empty if it did not."""
    if left is not None or graph.children[BRIDGE].running:
        graph.stop()
        return "no stack answers" if left is None else "the stack left"
    try:
        graph.watch(quiet=True)
    except GraphFailed as error:
        return str(error)
    return ""


def _watch_end(check: Check, bystander: Bystander, stack: Child | None, evidence: Evidence) -> None:
    """Watches the stack after the run, and notes its ending, and the step at which it left the run, if it did.

    A silent stack that was started elsewhere is watched until DDS would have noticed its death.
    """
    began_ns, began = time.time_ns(), time.monotonic()
    silent = evidence.state != FINISHED and evidence.left is None and stack is None and bool(evidence.discovered_s)
    watch = max(check.end_wait_s, LEASE_S) if silent else check.end_wait_s
    while (watched := time.monotonic() - began) < watch:
        bystander.listen(TICK_S)
        if not bystander.present and (stack is None or not stack.running):
            break
    if silent and not bystander.present and evidence.state in (FAILED, ""):
        evidence.left = evidence.newest
    after = [answer.received_ns for answer in evidence.heard if answer.received_ns > began_ns]
    last_s = 1e-9 * (after[-1] - began_ns) if after else None
    status, obituary = None, ""
    if stack is not None and not stack.running:
        status, obituary = stack.process.returncode, stack.obituary()
    evidence.ending = Ending(watched, last_s, bystander.present, status, obituary)


def _second_run(check: Check, nodes: Mapping[str, Path], bridge: Mapping[str, object]) -> str:
    """Makes the run once more with the stack that is up; returns why it is another one, empty if it is the same."""
    out = check.out / "second"
    graph = Graph(out, check.domain_id, check.answer_timeout_s)
    try:
        graph.start(BRIDGE, nodes[BRIDGE], bridge)
        graph.start(RECORDER, nodes[RECORDER], {"output": str(out), "overwrite": True})
        graph.watch(quiet=True)
    except GraphFailed as error:
        return str(error)
    finally:
        graph.stop()
    first, second = (digest(read_run(folder)) for folder in (check.out, out))
    return "" if first == second else "the ego drives otherwise than in the first run"


def _states(check: Check) -> dict[int, EgoState]:
    """Returns states of the ego by step, from the record; empty if there is none."""
    try:
        run = read_run(check.out)
    except InputError:
        return {}
    states = {table.step: ego_state(table, run.info.ego_id) for table in run.tables}
    return {step: state for step, state in states.items() if state is not None}
