"""Many short runs of the graph: each ends well, with the digest that is known of it, and leaves nothing.

``make soak``, or ``./litsim exec python tests/soak/soak.py --runs 100``. Results go to a file as they come, and a soak
that was interrupted goes on from there, as long as the commit is the same; the page is written whenever it ends. The
digest that is known of a run is that of the same run in one process.

A run that is not as it should be, and whose domain has nodes of others on this machine, is spoilt: that is said, and
the run is done again.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import litsim_sim  # isort: skip  # noqa: F401 - before numpy: chooses its code, as in the nodes; digests depend on it
import numpy as np
from tqdm import tqdm

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.benchmark.steps import write_scenario
from litsim_eval.runs.in_process import record
from litsim_research.paper.page import fill
from litsim_sim.core.errors import EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED, InputError, print_error
from litsim_sim.core.parameters import by_stage
from litsim_sim.launch.nodes import find_executable
from litsim_sim.record.run import read_run
from litsim_sim.scenario.run_info import RunPlan, versions
from litsim_sim.scenario.scenario import Scenario

MARK = "LITSIM_SOAK"  # variable by which the processes of a run are known
LOOK_S = 0.05  # [s] between two looks at the memory of a run
LOOKS_MIN = 200  # before which most of a run is its start, and its growth says nothing
LIMIT_S = 3600.0  # [s] after which a run is ended
LAUNCHER = "launch"
NODES = "/lib/litsim_"  # part of the path of every LitSim executable
ATTEMPTS = 3  # at a run that others spoil
COMMAND = "make soak"  # between whose marks the page is filled
ANNOUNCED = re.compile(r"in ROS_DOMAIN_ID (\d+)")
COLUMNS = (
    "case",
    "runs",
    "digest",
    "wall, median [s]",
    "launcher [MB]",
    "from run to run [MB]",
    "node [MB]",
    "from run to run [MB]",
    "within a run [MB]",
)
SHARED_MEMORY = "/dev/shm/"
TRACING = "/dev/shm/lttng-ust-wait"  # one file for all that LTTng might trace, which is there for good


def children(parent: int) -> dict[str, int]:
    """Returns ids of the LitSim processes that the process `parent` has started, by the name of their executable."""
    processes = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
        except OSError:  # it has ended
            continue
        program = next((word for word in words if NODES in word), "")
        if int(fields[1]) == parent and program:
            processes[Path(program).name] = int(folder.name)
    return processes


def resident_mb(process: int) -> float:
    """Returns the resident memory of a process [MB]; 0 if it has ended."""
    try:
        pages = int((Path("/proc") / str(process) / "statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@dataclass(frozen=True)
class Case:
    """A run: `name`, and what the launcher is given beside the file of the scenario and where to record."""

    name: str
    scenario: Path
    ego: str
    policy: str
    settings: tuple[str, ...] = ()

    @property
    def words(self) -> list[str]:
        """The launcher's arguments."""
        given = ["--scenario", str(self.scenario), "--ego", self.ego, "--policy", self.policy]
        return [*given, *(["--set", *self.settings] if self.settings else [])]

    def plan(self) -> RunPlan:
        """The same run, to be run in this process."""
        given = [setting.partition("=") for setting in self.settings]
        split = [(*name.split(".", 1), json.loads(value)) for name, _, value in given]
        return RunPlan(Scenario.load(self.scenario), self.ego, self.policy, by_stage(split))


@dataclass(frozen=True)
class Result:
    """What came of a run.

    Attributes:
        number: of the run, from 0.
        status: exit status of the launcher.
        wrong: in words, whatever is not as it should be; empty for nothing.
        foreign: nodes of others in the domain, where anything is not as it should be: they may have spoilt the run.
        wall_s: that the run took [s].
        memory_mb: the largest resident memory by process [MB].
        growth_mb: by process, how much more that is in the last quarter of the run than in the second [MB].
    """

    number: int
    case: str
    status: int
    digest: str
    wrong: tuple[str, ...]
    foreign: tuple[str, ...]
    wall_s: float
    memory_mb: dict[str, float]
    growth_mb: dict[str, float]
    commit: str

    @property
    def spoilt(self) -> bool:
        """Whether it says nothing, since others were there."""
        return bool(self.wrong and self.foreign)


def cases_in(folder: Path, *, long: bool) -> list[Case]:
    """The cases that take turns; those of `long` are one with a thousand agents and one of ten minutes."""
    if long:
        return [
            Case("1000 agents, 5 s", write_scenario(folder, 1000, 6.0), "idm", "litsim"),
            Case("80 agents, ten minutes", write_scenario(folder, 80, 601.0), "idm", "litsim"),
        ]
    small, large = write_scenario(folder, 30, 4.0), write_scenario(folder, 80, 4.0)
    brake = ('ego.kind="brake"', "ego.time=[0.0, 0.0]")
    return [
        Case("30, idm, litsim", small, "idm", "litsim"),
        Case("80, bat, litsim", large, "bat", "litsim"),
        Case("30, log, yield", small, "log", "yield"),
        Case("80, idm, replay", large, "idm", "replay"),
        Case("30, brake, litsim", small, "perturbed", "litsim", brake),
        Case("80, log, replay", large, "log", "replay"),
        Case("30, bat, yield", small, "bat", "yield"),
        Case("80, brake, yield", large, "perturbed", "yield", brake),
    ]


def known_digests(cases: Sequence[Case], kept: Path) -> dict[str, str]:
    """The digest of each case's run in one process, by the name of the case; `kept` holds those of this commit."""
    commit = versions()["commit"]
    found: dict[str, dict[str, str]] = json.loads(kept.read_text()) if kept.is_file() else {}
    known = found.get(commit, {})
    for case in tqdm([case for case in cases if case.name not in known], desc="known digests", unit="case"):
        known[case.name] = str(compute_metrics(record(case.plan()))["digest"])
        kept.write_text(json.dumps({commit: known}))
    return known


class Watch(threading.Thread):
    """Looks at a launcher and its nodes while they run.

    Attributes:
        looks: resident memory [MB] by process.
        shared: files in shared memory that they have mapped.
    """

    def __init__(self, process: int) -> None:
        super().__init__(daemon=True)
        self._process, self._over = process, threading.Event()
        self.looks: dict[str, list[float]] = {}
        self.shared: set[str] = set()

    def run(self) -> None:
        """See :class:`threading.Thread`."""
        while not self._over.wait(LOOK_S):
            for name, process in {LAUNCHER: self._process, **children(self._process)}.items():
                if found := resident_mb(process):
                    self.looks.setdefault(name, []).append(found)
                    self.shared |= shared_memory(process)

    def end(self) -> None:
        """Look no more."""
        self._over.set()
        self.join()

    @property
    def peaks(self) -> dict[str, float]:
        """The largest that was seen."""
        return {name: round(max(looks), 1) for name, looks in sorted(self.looks.items())}

    @property
    def growth(self) -> dict[str, float]:
        """From the median of the second quarter of the looks to that of the last."""
        quarters = {
            name: np.array_split(np.array(looks), 4) for name, looks in self.looks.items() if len(looks) >= LOOKS_MIN
        }
        return {name: round(float(np.median(q[3]) - np.median(q[1])), 1) for name, q in sorted(quarters.items())}


def run_once(number: int, case: Case, folder: Path, known: str, commit: str) -> Result:
    """One run of the graph of `commit`, whose digest should be `known`, and what is left when it has ended."""
    mark, bag = uuid.uuid4().hex, folder / "run"
    program = find_executable("litsim_sim", LAUNCHER)
    environment = {k: v for k, v in os.environ.items() if k != "ROS_DOMAIN_ID"} | {MARK: mark}
    begin = time.monotonic()
    with subprocess.Popen(
        [str(program), *case.words, "--out", str(bag), "--overwrite", "--no-analyze"],
        env=environment | {"PYTHONUNBUFFERED": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        watch = Watch(process.pid)
        watch.start()
        try:
            out, err = process.communicate(timeout=LIMIT_S)
        finally:
            process.terminate()
            watch.end()
    wall_s = time.monotonic() - begin
    wrong, digest = [], ""
    if process.returncode:
        wrong.append(f"exit status {process.returncode}: {(err.strip().splitlines() or ['nothing said'])[-1]}")
    else:
        digest = str(compute_metrics(read_run(bag))["digest"])
        if digest != known:
            wrong.append(f"digest {digest[:12]}, expected {known[:12]}")
    wrong += left_over(mark, watch.shared)
    announced = ANNOUNCED.search(out)
    others = tuple(foreign_nodes(announced[1], mark)) if wrong and announced else ()
    figures = (round(wall_s, 2), watch.peaks, watch.growth)
    return Result(number, case.name, process.returncode, digest, tuple(wrong), others, *figures, commit)


def foreign_nodes(domain: str, mark: str) -> Iterator[str]:
    """Command lines of what has been started in a DDS domain of this machine, and not for the run with that `mark`."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            variables = (folder / "environ").read_bytes().split(b"\0")
            in_domain = f"ROS_DOMAIN_ID={domain}".encode() in variables
            if in_domain and f"{MARK}={mark}".encode() not in variables and b"librmw" in (folder / "maps").read_bytes():
                yield (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
        except OSError:  # it has ended, or is somebody else's
            continue


def left_over(mark: str, shared: Iterable[str]) -> Iterator[str]:
    """In words, what a run has left: processes, who hold their domain too, and files of the `shared` memory it used."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() in (folder / "environ").read_bytes():
                yield f"process {folder.name} is left"
        except OSError:  # it has ended, or is somebody else's
            continue
    yield from (f"shared memory {path} is left" for path in sorted(shared) if Path(path).exists())


def shared_memory(process: int) -> set[str]:
    """Files in shared memory that a process has mapped."""
    try:
        lines = (Path("/proc") / str(process) / "maps").read_text().splitlines()
    except OSError:  # it has ended
        return set()
    mapped = {line.split(maxsplit=5)[-1] for line in lines}
    return {path for path in mapped if path.startswith(SHARED_MEMORY) and not path.startswith(TRACING)}


def open_files() -> int:
    """Files that this process has open."""
    return len(list(Path("/proc/self/fd").iterdir()))


def soak(folder: Path, runs: int, *, long: bool) -> list[Result]:
    """Do what is not done yet of `runs` runs; results are kept in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / ("long.jsonl" if long else "runs.jsonl")
    results = results_in(kept)
    commit = versions()["commit"]
    if others := {each.commit for each in results} - {commit}:
        raise InputError(
            f"{kept}: holds runs of commit {', '.join(others)}, expected {commit}: remove it to begin anew"
        )
    cases = cases_in(folder, long=long)
    known = known_digests(cases, folder / "digests.json")
    files = open_files()
    done = {each.number for each in results if not each.spoilt}
    for number in tqdm(sorted(set(range(runs)) - done), desc="soak", unit="run", initial=len(done), total=runs):
        case = cases[number % len(cases)]
        for _ in range(ATTEMPTS):
            result = run_once(number, case, folder, known[case.name], commit)
            if open_files() > files:
                result = replace(result, wrong=(*result.wrong, f"{open_files() - files} files are left open"))
            results.append(result)
            with kept.open("a") as stream:
                stream.write(json.dumps(asdict(result)) + "\n")
            if not result.spoilt:
                break
    return results


def results_in(kept: Path) -> list[Result]:
    """What a soak has done so far; the last line may be cut short, where it was killed."""
    if not kept.is_file():
        return []
    whole, _, rest = kept.read_text().rpartition("\n")
    if rest:
        kept.write_text(f"{whole}\n" if whole else "")
    results = [Result(**json.loads(line)) for line in whole.splitlines()]
    return [replace(each, wrong=tuple(each.wrong), foreign=tuple(each.foreign)) for each in results]


def page(results: Sequence[Result], title: str) -> str:
    """Results as Markdown: a line of sums, a row for each case, and what went wrong."""
    cores, seconds = os.cpu_count(), sum(each.wall_s for each in results)
    spoilt = [each for each in results if each.spoilt]
    results = [each for each in results if not each.spoilt]
    failed = [each for each in results if each.wrong]
    right = len(results) - len(failed)
    again = f", and {len(spoilt)} more disturbed by other nodes" if spoilt else ""
    lines = [
        f"**{title}**: {len(results)} runs, {right} of them correct{again}. {seconds:.0f} s on {cores} cores.",
        "",
        f"| {' | '.join(COLUMNS)} |",
        "|---|---:|---|---:|---:|---:|---:|---:|---:|",
    ]
    for case in dict.fromkeys(each.case for each in results):
        of = [each for each in results if each.case == case]
        launcher = [each.memory_mb.get(LAUNCHER, np.nan) for each in of]
        nodes = [max((mb for name, mb in each.memory_mb.items() if name != LAUNCHER), default=np.nan) for each in of]
        within = max((mb for each in of for mb in each.growth_mb.values()), default=None)
        figures = (
            f"{np.nanmax(launcher):.0f}",
            slope(launcher),
            f"{np.nanmax(nodes):.0f}",
            slope(nodes),
            "–" if within is None else f"{within:+.1f}",
        )
        wall = f"{np.median([each.wall_s for each in of]):.1f}"
        lines.append(f"| {case} | {len(of)} | `{of[0].digest[:12]}` | {wall} | {' | '.join(figures)} |")
    lines += ["", *(f"- run {each.number}, {each.case}: {'; '.join(each.wrong)}" for each in failed)]
    lines += [f"- run {each.number} was spoilt: {'; '.join(each.wrong)}; {', '.join(each.foreign)}" for each in spoilt]
    return "\n".join(lines).rstrip() + "\n"


def slope(values: Sequence[float]) -> str:
    """Growth from one value to the next, a fitted line's; a dash where there are too few."""
    return f"{np.polyfit(np.arange(len(values)), values, 1)[0]:+.2f}" if len(values) > 2 else "–"


def main() -> int:
    """Soak; the exit status is 1 where anything is not as it should be."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--runs", type=int, default=100)
    p.add_argument("--long", action="store_true", help="instead: 1000 agents, and ten minutes; twice 1 run")
    p.add_argument("--folder", type=Path, default=Path("bags/soak"), help="where results are kept as they come")
    p.add_argument("--page", type=Path, default=Path("docs/performance.md"), help="filled between its marks")
    arguments = p.parse_args()
    folder = arguments.folder.absolute()  # nets are named from where their scenarios lie
    try:
        runs = 2 if arguments.long else arguments.runs
        results = [each for each in soak(folder, runs, long=arguments.long) if not each.spoilt]
    except InputError as error:
        print_error(error)
        return EXIT_INPUT
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    finally:
        write_page(folder, arguments.page)
    return EXIT_FAILED if len(results) < runs or any(each.wrong for each in results) else 0


def write_page(folder: Path, path: Path) -> None:
    """Write what has been done so far, if anything."""
    found = {"Many runs": results_in(folder / "runs.jsonl"), "Large runs": results_in(folder / "long.jsonl")}
    if not any(found.values()):
        return
    lines: list[str] = []
    for title, results in found.items():
        if results:
            commits = ", ".join(dict.fromkeys(each.commit for each in results))
            lines += [*page(results, title).splitlines(), "", f"Commit {commits}.", ""]
    fill(path, COMMAND, lines[:-1])


if __name__ == "__main__":
    sys.exit(main())
