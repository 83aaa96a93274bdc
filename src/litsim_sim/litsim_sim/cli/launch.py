"""Launch a whole run: every node as its own process, watched until the run is recorded and analysed."""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import domain_coordinator
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from tqdm import tqdm

from litsim_sim.cli.analyze import analyze, print_metrics
from litsim_sim.errors import InputError
from litsim_sim.run_info import EGOS, POLICIES, RunPlan
from litsim_sim.scenario import Scenario

GRACE_S = 8.0  # [s] that the bridge and the recorder get to end a run in good order
KILL_S = 3.0  # [s] between SIGINT, SIGTERM and SIGKILL
EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED = 1, 2, 130

EXECUTABLES = {
    "recorder": ("litsim_sim", "recorder"),
    "predictor": ("litsim_predictor", "predictor"),
    "conflict": ("litsim_policy", "conflict"),
    "policy": ("litsim_policy", "policy"),
    "bridge": ("litsim_sim", "bridge"),
}


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

    def last_words(self) -> str:
        """The last error that the node logged, or its last line."""
        lines = [line.strip() for line in self.log.read_text(errors="replace").splitlines() if line.strip()]
        errors = [line for line in lines if line.startswith("error:")]
        return (errors or lines or ["it said nothing"])[-1]


class GraphFailed(Exception):
    """A node died or the bridge ended the run; the message says which and why."""


class Graph:
    """The processes of one run."""

    def __init__(self, out: Path, domain_id: int) -> None:
        self._log_folder = out / "log"
        self._log_folder.mkdir(parents=True, exist_ok=True)
        discovery = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self._environment = os.environ | {
            "ROS_DOMAIN_ID": str(domain_id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery,
            "PYTHONUNBUFFERED": "1",
        }
        self.children: dict[str, Child] = {}

    def start(self, name: str, package: str, executable: str, parameters: dict[str, object]) -> Child:
        """Start `executable` of `package`, the one that ``ros2 run`` starts, as node `name`."""
        try:
            path = Path(get_package_prefix(package)) / "lib" / package / executable
        except PackageNotFoundError as error:
            raise InputError(f"package {package} is not built or not sourced: {error}") from error
        if not path.is_file():
            raise InputError(f"{path}: no such executable; build the workspace (make build)")
        arguments = [str(path), "--ros-args"]
        for key, value in parameters.items():
            arguments += ["-p", f"{key}:={value}"]
        log = self._log_folder / f"{name}.log"
        pipe = name == "bridge"
        with log.open("w") as stream:
            process = subprocess.Popen(
                arguments,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if pipe else stream,
                stderr=stream,
                text=True,
                start_new_session=True,
            )
        self.children[name] = Child(name, process, log)
        return self.children[name]

    def watch(self, quiet: bool) -> None:
        """Wait for the run to end.

        Raises:
            GraphFailed: a node died before the run was over, or the bridge says that the run failed.
        """
        bridge = self.children["bridge"]
        assert bridge.process.stdout is not None
        progress = threading.Thread(target=_show_progress, args=(bridge.process.stdout, quiet), daemon=True)
        progress.start()
        while bridge.running:
            dead = [c for c in self.children.values() if not c.running and c.name not in ("bridge", "recorder")]
            recorder = self.children["recorder"]
            if not recorder.running and recorder.process.returncode != 0:
                dead.append(recorder)
            if dead:
                time.sleep(0.1)  # what a node says when it ends arrives before the bridge has ended over it
                raise GraphFailed(
                    "; ".join(f"node {c.name} ended with {_status(c.process.returncode)}: {c.last_words()}" for c in dead)
                )
            time.sleep(0.05)
        progress.join(timeout=1.0)
        if bridge.process.returncode != 0:
            raise GraphFailed(bridge.last_words().removeprefix("error: "))
        recorder = self.children["recorder"]
        with contextlib.suppress(subprocess.TimeoutExpired):
            recorder.process.wait(GRACE_S)
        if recorder.process.returncode != 0:
            raise GraphFailed(f"node recorder ended with {_status(recorder.process.returncode)}: {recorder.last_words()}")

    def stop(self) -> None:
        """End what still runs: first the bridge, which tells the recorder to close its file, then the rest."""
        ordered = [self.children[n] for n in ("bridge", "recorder") if n in self.children]
        for child in ordered:
            child.signal(signal.SIGINT) if child.name == "bridge" else None
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.process.wait(GRACE_S if child.name == "bridge" else KILL_S)
        killed = False
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            running = [c for c in self.children.values() if c.running]
            for child in running:
                child.signal(number)
                killed |= number == signal.SIGKILL
            until = time.monotonic() + KILL_S
            while any(c.running for c in running) and time.monotonic() < until:
                time.sleep(0.02)
        if killed and (clean := shutil.which("fastdds")):
            subprocess.run([clean, "shm", "clean"], capture_output=True, check=False, timeout=10)


def launch(arguments: argparse.Namespace) -> int:
    """Run the graph that the arguments ask for; returns the exit status."""
    plan = RunPlan(_scenario(arguments), arguments.ego, arguments.policy)
    out = Path(arguments.out or f"bags/{plan.scenario.name}")
    _check_output(out, arguments.overwrite)
    bridge = {
        "scenario": arguments.scenario,
        "ego": plan.ego,
        "policy": plan.policy,
        "ego_id": plan.scenario.ego_id,
        "seed": plan.scenario.seed,
        "mode": arguments.mode,
        "on_missing": arguments.on_missing,
        "answer_timeout_s": arguments.answer_timeout,
        "progress": "lines",
    }
    with _domain(arguments) as domain_id:
        graph = Graph(out, domain_id)
        say(arguments, f"run {plan.run_id} in ROS_DOMAIN_ID {domain_id}")
        try:
            graph.start("recorder", *EXECUTABLES["recorder"], {"output": out, "overwrite": arguments.overwrite})
            for stage in plan.stages:
                if stage in ("predictor", "conflict", "policy"):
                    graph.start(stage, *EXECUTABLES[stage], {})
                elif stage == "ego":
                    graph.start("ego", "litsim_policy", f"ego_{plan.ego}", {})
            graph.start("bridge", *EXECUTABLES["bridge"], bridge)
            graph.watch(arguments.quiet)
        except GraphFailed as error:
            print(f"error: {error} (logs: {out / 'log'})", file=sys.stderr)
            return EXIT_FAILED
        except KeyboardInterrupt:
            print("\ninterrupted: ending the graph", file=sys.stderr)
            return EXIT_INTERRUPTED
        finally:
            _without_interrupts(graph.stop)
    if arguments.analyze:
        metrics = analyze(out)
        if not arguments.quiet:
            print_metrics(metrics)
        if not metrics["valid"]:
            print(f"error: {out}: the run is not valid: {metrics['why']}", file=sys.stderr)
            return EXIT_FAILED
    say(arguments, f"recorded in {out}")
    return 0


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_sim launch``."""
    p = argparse.ArgumentParser(prog="launch", description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    p.add_argument("--scenario", default="demo", help="name of a packaged scenario, or a YAML file")
    p.add_argument("--ego", default="idm", choices=EGOS, help="what drives the ego; external: your stack, over topics")
    p.add_argument("--policy", default="litsim", choices=POLICIES, help="what moves the background")
    p.add_argument("--out", help="folder of the recording; bags/SCENARIO where not given")
    p.add_argument("--overwrite", action="store_true", help="replace a recording that is there already")
    p.add_argument("--ego-id", type=int, help="another vehicle of the recording as the ego")
    p.add_argument("--seed", type=int, help="another seed than the scenario's")
    p.add_argument("--mode", default="lockstep", choices=("lockstep", "realtime"), help="who waits for whom")
    p.add_argument("--on-missing", default="stop", choices=("stop", "hold"), help="in lockstep, after the timeout")
    p.add_argument("--answer-timeout", type=float, default=5.0, metavar="S", help="for the answers to one step")
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
    overrides = {"ego": arguments.ego_id, "seed": arguments.seed}
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


@contextlib.contextmanager
def _domain(arguments: argparse.Namespace) -> Iterator[int]:
    """The DDS domain of the graph, reserved while it runs where it was not chosen by the user."""
    chosen = arguments.domain_id if arguments.domain_id is not None else os.environ.get("ROS_DOMAIN_ID")
    if chosen is not None or arguments.ego == "external":
        yield int(chosen or 0)
        return
    with domain_coordinator.domain_id() as free:
        yield free


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


def _status(code: int | None) -> str:
    if code is None:
        return "no exit in time"
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"


def _without_interrupts(action: object) -> None:
    """Run `action` with Ctrl-C held back, so that impatience leaves no orphans."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        action()  # type: ignore[operator]
    finally:
        signal.signal(signal.SIGINT, before)


def main() -> None:
    """Entry point of ``ros2 run litsim_sim launch``."""
    arguments = parser().parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of scripts begin with it ignored
    try:
        sys.exit(launch(arguments))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(EXIT_INPUT)


if __name__ == "__main__":
    main()
