"""Launch a whole run: start its nodes, watch them until the run is recorded, and measure it."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

from litsim_sim.cli.arguments import DefaultsFormatter, Parser, positive
from litsim_sim.cli.program import interrupt_on_signals, program, run_status
from litsim_sim.cli.run_arguments import add_run_arguments, plan_of
from litsim_sim.core import plugins
from litsim_sim.core.errors import EXIT_FAILED, InputError, print_error
from litsim_sim.core.stages import BRIDGE
from litsim_sim.core.topic_names import AUTO, EGO_INPUTS, INTERFACES
from litsim_sim.io.files import Unwritable
from litsim_sim.kernels.garbage import without_collection
from litsim_sim.launch.adapters import EgoAdapter, adapter_names, adapter_of
from litsim_sim.launch.child import check_program
from litsim_sim.launch.domain import graph_domain
from litsim_sim.launch.middleware import check_logging, check_security
from litsim_sim.launch.net_check import begin_net_check
from litsim_sim.launch.nodes import MODES, STOP_OR_HOLD, GraphNode, find_executable, in_one_process, nodes_of
from litsim_sim.launch.output import check_output, held_output
from litsim_sim.launch.processes import Graph, GraphFailed
from litsim_sim.launch.signals import without_interrupts
from litsim_sim.nodes.shared import prepare_nodes
from litsim_sim.record.bag import discard_derived, make_room
from litsim_sim.record.failure import write_failure
from litsim_sim.record.seal import write_seal
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan, ego_names

STATUS_HELP = (
    "Exit status: 0, the run is valid, and meets the criteria, if any; 1, it failed, is not valid or does not "
    "meet them, and stderr says why; 2, bad input."
)


def launch(arguments: argparse.Namespace) -> int:
    """Run the graph; return the exit status. An InputError is raised before anything is started."""
    with without_collection():  # the first step comes 1.07 times as late without this (1.01 to 1.10, 5 pairs)
        check_security(os.environ)
        check_logging(os.environ)
        if arguments.criteria is not None:
            if not arguments.analyze:
                raise InputError("--criteria and --no-analyze: a run is judged by its measures, expected one of them")
            _analyses(arguments.criteria)  # so that bad criteria are refused
        started_here = bool(arguments.command)
        adapter = _through_adapter(arguments)
        plan = plan_of(arguments)
        if arguments.command and plan.ego != EXTERNAL:
            raise InputError(f"{shlex.join(arguments.command)}: the ego is {plan.ego}, expected --ego {EXTERNAL}")
        if arguments.command:
            check_program(arguments.command)
        check_net = begin_net_check(plan.scenario.net_path)
        domain = graph_domain(arguments.domain_id, reserve=plan.ego != EXTERNAL or started_here)
        out = Path(f"bags/{plan.scenario.name}" if arguments.out is None else arguments.out)
        nodes = nodes_of(
            plan,
            arguments.scenario,
            out,
            overwrite=arguments.overwrite,
            mode=arguments.mode,
            on_missing=arguments.on_missing,
            on_invalid=arguments.on_invalid,
            ego_interface=arguments.ego_interface,
            answer_timeout_s=arguments.answer_timeout,
            real_time_factor=arguments.real_time_factor,
            clock=adapter is None,
            served=arguments.served,
            record=arguments.record,
            progress="lines",
        )
        nodes = nodes if arguments.apart else in_one_process(nodes)
        paths = {node.name: find_executable(node.package, node.executable) for node in nodes}
        prepare_nodes()
        check_net()
    with ExitStack() as held:
        with domain as domain_id:  # before the folder is made, which a run that is refused would leave behind
            check_output(out, arguments.overwrite)
            held.enter_context(held_output(out))
            make_room(out, arguments.overwrite)  # else an earlier recording would remain if this run fails early
            graph = Graph(out, domain_id, arguments.answer_timeout)
            _announce(arguments, plan, domain_id)
            try:
                _run(graph, out, nodes, paths, arguments)
                write_seal(out, graph.facts())
            except GraphFailed as error:
                print_error(f"{error} (logs: {out / 'log'})")
                with suppress(Unwritable):  # as on a disk that is full, of which the run may have failed
                    write_failure(out, str(error))
                if arguments.analyze:
                    _recorded(out, arguments, None, failed=True)
                return EXIT_FAILED
        if arguments.analyze:
            status = _recorded(out, arguments, arguments.criteria)
        else:
            status = run_status({"valid": not graph.invalid, "why": graph.invalid}, out)
    if not status:
        say(arguments, f"recorded in {out}")
    return status


def _run(
    graph: Graph, out: Path, nodes: list[GraphNode], paths: dict[str, Path], arguments: argparse.Namespace
) -> None:
    """Start `nodes` and the user's stack, and wait for the run to end; always end all processes.

    Measures of the run that are in `out` by then are somebody else's, and are removed.

    Raises:
        GraphFailed: the run has failed.
        InputError: the stack cannot be started.
    """
    try:
        if arguments.command:  # first: it may take long to get ready
            graph.start_stack(arguments.command)
        for node in nodes:
            graph.start(node.name, paths[node.name], node.parameters, forked=True, several=node.several)
        graph.watch(arguments.quiet)
    except KeyboardInterrupt:
        print("\ninterrupted: ending the graph", file=sys.stderr)
        raise
    finally:
        without_interrupts(graph.stop)
        discard_derived(out)


def _recorded(out: Path, arguments: argparse.Namespace, criteria: str | None, *, failed: bool = False) -> int:
    """Let the plug-ins of ``litsim.recorded`` work on the recording in `out`; return the highest exit status of theirs.

    Without criteria they are imported after the run, so that the nodes start without waiting for them.
    """
    quiet, case = arguments.quiet or failed, arguments.case
    return max((analysis(out, quiet=quiet, failed=failed, case=case) for analysis in _analyses(criteria)), default=0)


def _analyses(criteria: str | None) -> list[Callable[..., int]]:
    """Returns the plug-ins of ``litsim.recorded``, which judge by `criteria`; raises InputError if these do not fit."""
    return [plugins.load(plugins.RECORDED, name)(criteria) for name in plugins.names(plugins.RECORDED)]


def _through_adapter(arguments: argparse.Namespace) -> EgoAdapter | None:
    """Let an ego that is an adapter be an external one, which the adapter's program starts; returns the adapter."""
    adapter = adapter_of(arguments.ego)
    if adapter is not None:
        arguments.ego, arguments.command = EXTERNAL, adapter.command(arguments.command)
        arguments.record = [*adapter.record, *arguments.record]
        if not any(setting[:2] == (BRIDGE, "external_timeout_s") for setting in arguments.set):
            arguments.set = [*arguments.set, (BRIDGE, "external_timeout_s", adapter.ready_s)]
    return adapter


def _announce(arguments: argparse.Namespace, plan: RunPlan, domain_id: int) -> None:
    say(arguments, f"run {plan.identity} in ROS_DOMAIN_ID {domain_id}")
    if plan.ego == EXTERNAL and not arguments.command:
        topics = [topic for interface, topic in EGO_INPUTS.items() if arguments.ego_interface in (AUTO, interface)]
        say(arguments, f"waiting for an external ego to answer on {' or '.join(topics)}")


def parser() -> argparse.ArgumentParser:
    """Returns the parser of ``ros2 run litsim_sim launch``."""
    p = Parser(prog="launch", description=__doc__, epilog=STATUS_HELP, formatter_class=DefaultsFormatter)
    add_run_arguments(p, (*ego_names(), *adapter_names()))
    p.add_argument("--out", help="folder of the record; default: bags/SCENARIO")
    p.add_argument("--overwrite", action="store_true", help="replace an existing record")
    p.add_argument(
        "--mode", default=MODES[0], choices=MODES, help="lockstep: the world waits for answers; realtime: it does not"
    )
    p.add_argument(
        "--record",
        nargs="+",
        default=[],
        metavar="TOPIC",
        help="topics of the ego's stack to record as well, beside those that its adapter names",
    )
    p.add_argument(
        "--real-time-factor",
        type=positive,
        default=1.0,
        metavar="FACTOR",
        help="simulated time per wall time: in realtime of the steps; of /clock while a step waits for an external ego",
    )
    p.add_argument(
        "--on-missing",
        default="stop",
        choices=STOP_OR_HOLD,
        help="what to do if an answer is missing at the timeout, in lockstep",
    )
    p.add_argument(
        "--on-invalid", default="stop", choices=STOP_OR_HOLD, help="what to do if the ego's answer is invalid"
    )
    p.add_argument(
        "--ego-interface",
        default=AUTO,
        choices=INTERFACES,
        help="topic of an external ego; auto: the first that it uses",
    )
    p.add_argument(
        "--answer-timeout", type=positive, default=5.0, metavar="S", help="timeout of the answers to a step [s]"
    )
    p.add_argument(
        "--domain-id",
        type=int,
        help="default: ROS_DOMAIN_ID, else a free domain (0 for an external ego that you start yourself)",
    )
    p.add_argument(
        "--apart", action="store_true", help="one process per node; default: the stages and LitSim's own ego share one"
    )
    p.add_argument("--served", action="store_true", help=argparse.SUPPRESS)  # of `serve`
    p.add_argument("--case", type=Path, help=argparse.SUPPRESS)  # of campaigns: the folder of the case
    p.add_argument("--no-analyze", dest="analyze", action="store_false", help="record only")
    p.add_argument("--criteria", metavar="FILE", help="judge the run: criteria (YAML) as of a campaign, or default")
    p.add_argument("--quiet", action="store_true", help="print no progress and no table")
    p.add_argument(
        "command",
        nargs="*",
        metavar="COMMAND",
        help="after --: command that starts an external ego; without it, start the ego yourself",
    )
    return p


def say(arguments: argparse.Namespace, text: str) -> None:
    """Tell the user, unless told to be quiet."""
    if not arguments.quiet:
        print(text, flush=True)


@program
def main(argv: list[str] | None = None) -> int:
    """Entry point of ``ros2 run litsim_sim launch``."""
    arguments = parser().parse_args(argv)
    interrupt_on_signals()
    return launch(arguments)
