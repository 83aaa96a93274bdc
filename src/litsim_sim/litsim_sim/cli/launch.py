"""Launch a whole run: every node as its own process, watched until the run is recorded and analysed."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from litsim_sim.cli.analyze import analyze, print_metrics
from litsim_sim.cli.arguments import DefaultsFormatter, positive
from litsim_sim.core.errors import EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED, InputError
from litsim_sim.core.parameters import SET_HELP, by_stage, one_setting
from litsim_sim.core.stage_registry import configured, registered_name
from litsim_sim.core.vehicle import VEHICLE_FIELDS, VehicleModel
from litsim_sim.ego_port.answer import AUTO, INPUTS, INTERFACES, Interface
from litsim_sim.launch.domain import graph_domain
from litsim_sim.launch.executables import node_executable
from litsim_sim.launch.processes import SIGNALS, Graph, GraphFailed, without_interrupts
from litsim_sim.report.run_report import write_report
from litsim_sim.scenario.run_info import EGOS, EXTERNAL, POLICIES, RunPlan
from litsim_sim.scenario.scenario import Scenario


def launch(arguments: argparse.Namespace) -> int:
    """Run the graph that the arguments ask for; returns the exit status.

    Raises:
        InputError: something cannot be used; found before anything is started.
    """
    if arguments.ego != EXTERNAL and arguments.ego_interface != AUTO:
        raise InputError(
            f"--ego-interface {arguments.ego_interface}: the ego is {arguments.ego}, expected --ego external"
        )
    plan = RunPlan(_scenario(arguments), arguments.ego, arguments.policy)
    domain = graph_domain(arguments.domain_id, reserve=arguments.ego != EXTERNAL)
    nodes = {name: node_executable(name, plan.ego) for name in (*reversed(plan.stages), "bridge")}
    out = Path(arguments.out or f"bags/{plan.scenario.name}")
    parameters: dict[str, dict[str, object]] = {
        "recorder": {"output": str(out), "overwrite": arguments.overwrite},
        "bridge": {
            "scenario": str(arguments.scenario),
            "ego": plan.ego,
            "policy": plan.policy,
            "ego_id": plan.scenario.ego_id,
            "seed": plan.scenario.seed,
            "mode": arguments.mode,
            "on_missing": arguments.on_missing,
            "on_invalid": arguments.on_invalid,
            "ego_interface": arguments.ego_interface,
            "answer_timeout_s": arguments.answer_timeout,
            "progress": "lines",
        }
        | {f"vehicle.{name}": value for name, value in plan.scenario.file.vehicle.items()},
    }
    forecasts = arguments.predictor is not None and "predictor" in nodes
    chosen = [("predictor", "model", arguments.predictor)] if forecasts else []
    for stage, settings in by_stage([*chosen, *arguments.set]).items():
        parameters[stage] = parameters.get(stage, {}) | settings
    configured({name: registered_name(name, plan.ego) for name in nodes}, parameters)
    _check_output(out, arguments.overwrite)
    failure = None
    with domain as domain_id:
        graph = Graph(out, domain_id)
        say(arguments, f"run {plan.run_id} in ROS_DOMAIN_ID {domain_id}")
        if plan.ego == EXTERNAL:
            topics = [INPUTS[each] for each in Interface if arguments.ego_interface in (AUTO, each)]
            say(arguments, f"waiting for an external ego to answer on {' or '.join(topics)}")
        try:
            for name, path in nodes.items():
                graph.start(name, path, parameters.get(name, {}))
            graph.watch(arguments.quiet)
        except GraphFailed as error:
            failure = error
        except KeyboardInterrupt:
            print("\ninterrupted: ending the graph", file=sys.stderr)
            return EXIT_INTERRUPTED
        finally:
            without_interrupts(graph.stop)
    if failure:
        print(f"error: {failure} (logs: {out / 'log'})", file=sys.stderr)
        return EXIT_FAILED
    if arguments.analyze:
        metrics = analyze(out)
        write_report(out, metrics=metrics)
        if not arguments.quiet:
            print_metrics(metrics)
        if not metrics["valid"]:
            print(f"error: {out}: the run is not valid: {metrics['why']}", file=sys.stderr)
            return EXIT_FAILED
    say(arguments, f"recorded in {out}")
    return 0


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_sim launch``."""
    p = argparse.ArgumentParser(prog="launch", description=__doc__, formatter_class=DefaultsFormatter)
    p.add_argument("--scenario", default="demo", help="name of a packaged scenario, or a YAML file")
    p.add_argument("--ego", default="idm", choices=EGOS, help="what drives the ego; external: your stack, over topics")
    p.add_argument("--policy", default="litsim", choices=POLICIES, help="what moves the background")
    p.add_argument("--predictor", metavar="MODEL", help="instead of the one in the predictor node's parameters")
    p.add_argument("--out", help="folder of the recording; bags/SCENARIO where not given")
    p.add_argument("--overwrite", action="store_true", help="replace a recording that is there already")
    p.add_argument("--ego-id", type=int, help="another vehicle of the recording as the ego")
    p.add_argument("--seed", type=int, help="another seed than the scenario's")
    p.add_argument("--mode", default="lockstep", choices=("lockstep", "realtime"), help="who waits for whom")
    p.add_argument("--on-missing", default="stop", choices=("stop", "hold"), help="in lockstep, after the timeout")
    p.add_argument("--on-invalid", default="stop", choices=("stop", "hold"), help="where the ego's answer is no use")
    p.add_argument("--ego-interface", default="auto", choices=INTERFACES, help="of an external ego; auto: its first")
    p.add_argument(
        "--vehicle",
        type=_vehicle_value,
        nargs="+",
        default=[],
        metavar="NAME=VALUE",
        help=f"the ego's vehicle model, else the scenario's: {', '.join(VEHICLE_FIELDS)}",
    )
    p.add_argument("--set", type=one_setting, nargs="+", default=[], metavar="STAGE.NAME=VALUE", help=SET_HELP)
    p.add_argument("--answer-timeout", type=positive, default=5.0, metavar="S", help="for the answers to one step")
    p.add_argument(
        "--domain-id",
        type=int,
        help="ROS_DOMAIN_ID of the graph; else the one of the environment, or else a free one (external ego: 0)",
    )
    p.add_argument("--no-analyze", dest="analyze", action="store_false", help="record only")
    p.add_argument("--quiet", action="store_true", help="no progress, no table")
    return p


def say(arguments: argparse.Namespace, text: str) -> None:
    """Tell the user, unless told to be quiet."""
    if not arguments.quiet:
        print(text, flush=True)


def _scenario(arguments: argparse.Namespace) -> Scenario:
    overrides = {"ego": arguments.ego_id, "seed": arguments.seed, "vehicle": dict(arguments.vehicle) or None}
    return Scenario.load(arguments.scenario, **{k: v for k, v in overrides.items() if v is not None})


def _check_output(out: Path, overwrite: bool) -> None:
    """Refuse before anything is started."""
    if out.is_dir() and any(out.glob("*.mcap")) and not overwrite:
        raise InputError(f"{out}: holds a recording already; give another --out, or --overwrite")
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".write"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from error


def _vehicle_value(text: str) -> tuple[str, float]:
    """A field of the vehicle model and its value from the command line."""
    name, _, value = text.partition("=")
    try:
        VehicleModel.of({name: float(value)})
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: {error}") from error
    return name, float(value)


def main() -> None:
    """Entry point of ``ros2 run litsim_sim launch``."""
    arguments = parser().parse_args()
    for number in SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) == signal.SIG_DFL:  # nohup means it
            signal.signal(number, signal.default_int_handler)  # background jobs of scripts begin with SIGINT ignored
    try:
        sys.exit(launch(arguments))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(EXIT_INPUT)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
