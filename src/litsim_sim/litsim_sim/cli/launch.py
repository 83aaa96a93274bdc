"""Launch a whole run: every node as its own process, watched until the run is recorded and analysed."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from tqdm import tqdm

from litsim_sim.cli.analyze import analyze, print_metrics
from litsim_sim.cli.arguments import DefaultsFormatter, positive
from litsim_sim.domain import graph_domain
from litsim_sim.ego_answer import AUTO, INPUTS, INTERFACES, Interface
from litsim_sim.errors import InputError
from litsim_sim.executables import find_executable
from litsim_sim.parameters import SET_HELP, by_stage, one_setting
from litsim_sim.report.run_report import write_report
from litsim_sim.run_info import EGOS, EXTERNAL, POLICIES, RunPlan
from litsim_sim.scenario import Scenario
from litsim_sim.vehicle import VEHICLE_FIELDS, VehicleModel

GRACE_S = 8.0  # [s] that the bridge and the recorder get to end a run in good order
KILL_S = 3.0  # [s] between SIGINT, SIGTERM and SIGKILL
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG
EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED = 1, 2, 130

EXECUTABLES = {
    "recorder": ("litsim_sim", "recorder"),
    "predictor": ("litsim_predictor", "predictor"),
    "conflict": ("litsim_policy", "conflict"),
    "policy": ("litsim_policy", "policy"),
    "bridge": ("litsim_sim", "bridge"),
}
"""Package and executable of every node but the ego."""

_LIBC = ctypes.CDLL(None)


@dataclass
class Child:
    """A node's process, in a process group of its own, its output in a log file."""

    name: str
    process: subprocess.Popen[str]
    log: Path

    def signal(self, number: int) -> None:
        """Signal the whole group; `ros2 run`-like wrappers pass nothing on."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    @property
    def running(self) -> bool:
        """Whether the process has not ended yet."""
        return self.process.poll() is None

    @property
    def errors(self) -> list[str]:
        """Errors in its log."""
        lines = self.log.read_text(errors="replace").splitlines()
        return [line.removeprefix("error: ") for line in lines if line.startswith("error: ") or "[ERROR]" in line]

    def obituary(self) -> str:
        """How the process ended, and the last thing in its log where that may say why."""
        code, words = self.process.returncode, self.errors
        if code is None:
            how = f"has not ended within {GRACE_S:g} s"
        elif code < 0:
            how = f"was ended by {signal.Signals(-code).name}"
        else:
            how = f"ended with exit status {code}"
            words = words or (self.log.read_text(errors="replace").strip().splitlines() if code > 0 else [])
        return f"node {self.name} {how}{''.join(f': {line}' for line in words[-1:])}"


class GraphFailed(Exception):
    """A node died or the bridge ended the run; the message says which and why."""


class Graph:
    """The processes of one run."""

    def __init__(self, out: Path, domain_id: int) -> None:
        self._log_folder = out / "log"
        self._log_folder.mkdir(parents=True, exist_ok=True)
        for log in self._log_folder.glob("*.log"):  # of a run that is overwritten
            log.unlink()
        discovery = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self._environment = os.environ | {
            "ROS_DOMAIN_ID": str(domain_id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery,
            "PYTHONUNBUFFERED": "1",
        }
        self.children: dict[str, Child] = {}
        self._progress: threading.Thread | None = None

    def start(self, name: str, path: Path, parameters: dict[str, object]) -> None:
        """Start the executable at `path` as node `name`."""
        arguments = [str(path), "--ros-args"]
        for key, value in parameters.items():  # a text in quotes: YAML would find numbers and worse in it
            quoted = json.dumps(value, ensure_ascii=False) if isinstance(value, str | tuple) else value
            arguments += ["-p", f"{key}:={quoted}"]
        log = self._log_folder / f"{name}.log"
        with log.open("w") as stream, _held_back():
            process = subprocess.Popen(
                arguments,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if name == "bridge" else stream,
                stderr=stream,
                text=True,
                start_new_session=True,
                preexec_fn=_begin_child,  # noqa: PLW1509 - two system calls
            )
            self.children[name] = Child(name, process, log)

    def watch(self, quiet: bool) -> None:
        """Wait for the run to end.

        Raises:
            GraphFailed: a node died before the run was over, or the bridge says that the run failed.
        """
        bridge, recorder = self.children["bridge"], self.children["recorder"]
        assert bridge.process.stdout is not None
        self._progress = threading.Thread(target=_show_progress, args=(bridge.process.stdout, quiet), daemon=True)
        self._progress.start()
        while bridge.running:
            dead = [c for c in self.children.values() if not c.running and c is not bridge]
            dead = [c for c in dead if c is not recorder or recorder.process.returncode != 0]
            if dead:
                if all(child.process.returncode >= 0 for child in dead):
                    _wait([bridge], 1.0)  # they have told it, and it ends over it
                if bridge.running:
                    raise GraphFailed("; ".join(child.obituary() for child in dead))
            time.sleep(0.05)
        _wait([recorder], GRACE_S if bridge.process.returncode == 0 else 0.0)
        if bridge.process.returncode == EXIT_FAILED and bridge.errors:
            raise GraphFailed(bridge.errors[-1])
        for child in (bridge, recorder):
            if child.process.returncode != 0:
                raise GraphFailed(child.obituary())

    def stop(self) -> None:
        """End what still runs: first the bridge, which tells the recorder to close its file, then the rest."""
        bridge, recorder = self.children.get("bridge"), self.children.get("recorder")
        if bridge and bridge.running:
            bridge.signal(signal.SIGINT)
            _wait([bridge], GRACE_S if recorder and recorder.running else 0.5)
        if recorder and bridge and not bridge.running and bridge.process.returncode >= 0:
            _wait([recorder], KILL_S)  # it was told to close its file
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            running = [c for c in self.children.values() if c.running]
            for child in running:
                child.signal(number)
            _wait(running, KILL_S)
        if self._progress:
            self._progress.join(timeout=1.0)
        killed = any(c.process.returncode == -signal.SIGKILL for c in self.children.values())
        if killed and (fastdds := shutil.which("fastdds")):  # it leaves its shared memory behind
            with contextlib.suppress(subprocess.SubprocessError):
                subprocess.run([fastdds, "shm", "clean"], capture_output=True, check=False, timeout=10)


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
    nodes = {name: _executable(name, plan.ego) for name in (*reversed(plan.stages), "bridge")}
    settings = by_stage(arguments.set)
    if absent := sorted(set(settings) - set(nodes)):
        raise InputError(f"--set {', '.join(absent)}: takes no part in this run, expected {', '.join(sorted(nodes))}")
    out = Path(arguments.out or f"bags/{plan.scenario.name}")
    _check_output(out, arguments.overwrite)
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
        "predictor": {} if arguments.predictor is None else {"model": arguments.predictor},
    }
    failure = None
    with domain as domain_id:
        graph = Graph(out, domain_id)
        say(arguments, f"run {plan.run_id} in ROS_DOMAIN_ID {domain_id}")
        if plan.ego == EXTERNAL:
            topics = [INPUTS[each] for each in Interface if arguments.ego_interface in (AUTO, each)]
            say(arguments, f"waiting for an external ego to answer on {' or '.join(topics)}")
        try:
            for name, path in nodes.items():
                graph.start(name, path, parameters.get(name, {}) | settings.get(name, {}))
            graph.watch(arguments.quiet)
        except GraphFailed as error:
            failure = error
        except KeyboardInterrupt:
            print("\ninterrupted: ending the graph", file=sys.stderr)
            return EXIT_INTERRUPTED
        finally:
            _without_interrupts(graph.stop)
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


def _executable(name: str, ego: str) -> Path:
    """The file that ``ros2 run`` starts as node `name`."""
    package, program = ("litsim_policy", f"ego_{ego}") if name == "ego" else EXECUTABLES[name]
    return find_executable(package, program)


def _vehicle_value(text: str) -> tuple[str, float]:
    """A field of the vehicle model and its value from the command line."""
    name, _, value = text.partition("=")
    try:
        VehicleModel.of({name: float(value)})
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: {error}") from error
    return name, float(value)


def _show_progress(lines: IO[str], quiet: bool) -> None:
    """A bar from the bridge's lines `step K of N`."""
    bar = None
    for line in lines:
        words = line.split()
        if quiet or len(words) != 4 or words[0] != "step":
            continue
        step, total = int(words[1]), int(words[3])
        bar = bar or tqdm(total=total, unit="step", dynamic_ncols=True)
        bar.update(step - bar.n)
    if bar is not None:
        bar.close()


def _wait(children: list[Child], timeout: float) -> None:
    """Until all of `children` have ended, or for `timeout` seconds."""
    until = time.monotonic() + timeout
    while any(child.running for child in children) and time.monotonic() < until:
        time.sleep(0.02)


@contextlib.contextmanager
def _held_back() -> Iterator[None]:
    """Signals wait until this is over; Python swallows the exceptions of those that come amid a fork."""
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def _begin_child() -> None:
    """In a child before its program starts: end when the launcher is gone, whatever has ended it; hear signals."""
    _LIBC.prctl(DIE_WITH_PARENT, signal.SIGTERM)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def _without_interrupts(action: Callable[[], None]) -> None:
    """Run `action` with Ctrl-C held back, so that impatience leaves no orphans."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in SIGNALS}
    try:
        action()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
