"""Benchmark of a step: the time of each stage, SUMO, recording and transport, in process and over the graph; the start.

Each repetition measures all of them one after the other, under the same conditions; compare the ratios within a
repetition.
"""

from __future__ import annotations

import multiprocessing
import os
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from litsim_eval.analysis.measures.timing import step_path
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, AgentTable, FloatArray, Kind
from litsim_sim.core.stages import BRIDGE
from litsim_sim.launch.nodes import find_executable
from litsim_sim.record.bag import BagReader, BagWriter
from litsim_sim.record.run import Run, read_run
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation
from litsim_sim.world.sumo import SumoMirror

LANES = 5
LANE_WIDTH = 3.66  # [m]
SPACING = 10.0  # [m] between vehicles of a lane
SPEED = 8.0  # [m/s]
SIZE = (4.5, 1.8)  # [m]
EGO, POLICY = "idm", "litsim"
LOOP = ("predictor", "conflict", "policy")  # stages that wait for each other; the ego answers in parallel
FREE_ROAD = 400.0  # [m] of road ahead of the foremost vehicle
HISTORY_S = 3.0  # [s] without driven agents

IN_PROCESS, GRAPH, HIGHWAY_ENV = "in process", "graph with recording", "highway-env"
WITHOUT_SUMO = "in process without SUMO"  # as in `evaluate` and `train`
FIRST_STEP = "launcher to first step"
WORLD, SUMO, EGO_STAGE, RECORDING, TRANSPORT = "world", "SUMO", "ego", "recording", "transport and waiting"
WATCH = "watch over publishers, once a second"
PARTS = (WORLD, SUMO, *LOOP, EGO_STAGE, RECORDING, WATCH, TRANSPORT)
RATIOS = {
    "graph / in process": (GRAPH, IN_PROCESS),
    "highway-env / graph": (HIGHWAY_ENV, GRAPH),
    "highway-env / in process": (HIGHWAY_ENV, IN_PROCESS),
    "highway-env / in process without SUMO": (HIGHWAY_ENV, WITHOUT_SUMO),
}

PATH = "graph: "
"""Prefix of the parts of a step's way through the graph, see :mod:`litsim_eval.analysis.measures.timing`."""

Sample = dict[str, float]
"""Times of a step in one repetition [ms], by name: :data:`PARTS` (medians over the steps of the run, except transport,
which is the rest of a step), parts of its way through the graph (medians), and whole steps (means)."""


def columns_of_traffic(agents: int, seconds: float) -> Recording:
    """Returns a recording of `agents` vehicles in five lanes, all at 8 m/s and 10 m apart, for `seconds` [s].

    They are on the net of the demo; the ids go up from 1, lane by lane and then back along the road.
    """
    frames = round(seconds / STEP_S) + 1
    number = np.arange(agents)
    x0 = 15.0 + SPACING * (number // LANES) + 2.0 * (number % LANES)
    y0 = -LANE_WIDTH * (number % LANES + 0.5)
    frame, vehicle = (grid.ravel() for grid in np.meshgrid(np.arange(frames), number, indexing="ij"))
    table = pd.DataFrame({"vehicle_id": vehicle + 1, "frame": frame})
    table["x"] = x0[vehicle] + SPEED * STEP_S * frame
    table["y"] = y0[vehicle]
    table["yaw"] = table["acceleration"] = 0.0
    table["speed"] = SPEED
    table["length"], table["width"] = SIZE
    table["kind"] = int(Kind.CAR)
    table["lane"] = vehicle % LANES + 1
    return Recording.from_table(RecordingHeader("columns", source="generated for the benchmark"), table, "benchmark")


def write_scenario(folder: Path, agents: int, seconds: float) -> Path:
    """Writes a scenario of :func:`columns_of_traffic` on a straight road, with the ego in the middle.

    The ego keeps a longer headway than its log and falls back, so that agents behind it are taken over.
    """
    recording = columns_of_traffic(agents, seconds)
    recording.write(folder / f"{agents}.parquet")
    net = folder / f"{agents}.net.xml"
    net.write_text(straight_road(float(recording.table["x"].max()) + FREE_ROAD), encoding="utf-8")
    values = {
        "name": f"bench_{agents}",
        "recording": f"{agents}.parquet",
        "net": str(net),
        "ego": agents // 2 + 1,
        "history_s": HISTORY_S,
        "simulation_s": seconds - HISTORY_S,
    }
    path = folder / f"{agents}.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


def straight_road(length: float) -> str:
    """Returns a SUMO net of a straight road along +x, `length` [m] long, whose left edge is at y = 0."""
    centres = [-LANE_WIDTH * (LANES - lane - 0.5) for lane in range(LANES)]  # SUMO counts from the right
    lanes = "".join(
        f'<lane id="road_{lane}" index="{lane}" speed="36.00" length="{length:.2f}" width="{LANE_WIDTH}" '
        f'shape="0.00,{y:.2f} {length:.2f},{y:.2f}"/>'
        for lane, y in enumerate(centres)
    )
    incoming = " ".join(f"road_{lane}" for lane in range(LANES))
    width = LANES * LANE_WIDTH
    return (
        '<net version="1.20" junctionCornerDetail="5" limitTurnSpeed="5.50">'
        f'<location netOffset="0.00,0.00" convBoundary="0.00,{-width:.2f},{length:.2f},0.00" '
        f'origBoundary="0.00,{-width:.2f},{length:.2f},0.00" projParameter="!"/>'
        f'<edge id="road" from="begin" to="end" priority="1">{lanes}</edge>'
        f'<junction id="begin" type="dead_end" x="0.00" y="0.00" incLanes="" intLanes="" '
        f'shape="0.00,0.00 0.00,{-width:.2f}"/>'
        f'<junction id="end" type="dead_end" x="{length:.2f}" y="0.00" incLanes="{incoming}" intLanes="" '
        f'shape="{length:.2f},{-width:.2f} {length:.2f},0.00"/>'
        "</net>"
    )


class TimedMirror(SumoMirror):
    """SUMO with the time it takes in each step, `seconds` [s]."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario.net_path, scenario.seed, scenario.signals)
        self.seconds: list[float] = []

    def show(self, table: AgentTable) -> None:
        """See :class:`litsim_sim.world.sumo.SumoMirror`."""
        begin = time.perf_counter()
        super().show(table)
        self.seconds.append(time.perf_counter() - begin)

    def deviation(self, table: AgentTable) -> FloatArray:
        """See :class:`litsim_sim.world.sumo.SumoMirror`; its time counts as well."""
        begin = time.perf_counter()
        deviation = super().deviation(table)
        self.seconds[-1] += time.perf_counter() - begin
        return deviation


def time_in_process(scenario_file: Path, *, sumo: bool) -> Sample:
    """Times the steps after the history in a run in this process; by stage with SUMO, as a whole without."""
    scenario = Scenario.load(scenario_file)
    mirror = TimedMirror(scenario) if sumo else None
    simulation = Simulation.of(RunPlan(scenario, EGO, POLICY), mirror)
    parts: dict[str, list[float]] = {}
    begin, steps = 0.0, 0
    with closing(simulation.world):
        for result in simulation.steps():
            if result.table.step < scenario.history_steps:
                begin = time.perf_counter()
                continue
            steps += 1
            if mirror is None:
                continue
            shown = mirror.seconds[result.table.step]
            for name, seconds in (result.stage_s | {WORLD: result.stage_s["bridge"] - shown, SUMO: shown}).items():
                parts.setdefault(name, []).append(1e3 * seconds)
        whole = 1e3 * (time.perf_counter() - begin) / steps
    if mirror is None:
        return {WITHOUT_SUMO: whole}
    return {name: statistics.median(values) for name, values in parts.items() if name in PARTS} | {IN_PROCESS: whole}


def time_graph(scenario_file: Path, bag: Path, options: Sequence[str] = ()) -> Sample:
    """Times the steps after the history in a run over DDS, recorded to `bag`, with further `options` of the launcher.

    Raises:
        InputError: the run failed.
    """
    words = ["--quiet", "--overwrite", "--out", str(bag), "--scenario", str(scenario_file)]
    begin = time.perf_counter()
    execute(find_executable("litsim_sim", "launch"), *words, "--ego", EGO, "--policy", POLICY, *options)
    run = read_run(bag)
    return graph_sample(run) | {FIRST_STEP: 1e3 * (run.marks[BRIDGE][0]["shown"] - begin)}


def graph_sample(run: Run) -> Sample:
    """Returns times of the steps after the history in a run over DDS, from the recorded marks of bridge and stages."""
    begins = {step: marks["begin"] for step, marks in run.marks[BRIDGE].items() if step >= run.info.history_steps}
    first, last = min(begins), max(begins)
    whole = 1e3 * (begins[last] - begins[first]) / (last - first)
    paths = [path for step in begins if (path := step_path(step, run.marks))]
    parts = {f"{PATH}{name}": 1e3 * statistics.median(path[name] for path in paths) for name in paths[0]}
    spent = sum(
        1e3 * statistics.median(s for step, s in run.timing[stage].items() if step in begins)
        for stage in (BRIDGE, *LOOP)
    )
    watch = [1e3 * (marks["watched"] - marks["watch"]) for marks in run.marks[BRIDGE].values() if "watched" in marks]
    return {GRAPH: whole, TRANSPORT: whole - spent, WATCH: statistics.median(watch)} | parts


def time_recording(bag: Path, folder: Path) -> Sample:
    """Times the writing of the messages of `bag`: the work of the recorder per step without receiving them."""
    reader = BagReader(bag)
    messages = list(reader.messages())
    steps = 1 + round(max(message.log_time_ns for message in messages) * 1e-9 / STEP_S)
    begin = time.perf_counter()
    with BagWriter(folder, "again", overwrite=True) as writer:
        for topic in reader.topics.values():
            writer.add_topic(topic)
        for message in messages:
            writer.write(message.topic, message.data, message.log_time_ns)
    return {RECORDING: 1e3 * (time.perf_counter() - begin) / steps}


def time_highway_env(python: Path, script: Path, agents: int, steps: int) -> Sample:
    """Times highway-env with as many vehicles, at the same 10 Hz, with `python` of its own environment.

    Raises:
        InputError: it cannot be run.
    """
    return {HIGHWAY_ENV: float(execute(python, str(script), str(agents), str(steps)))}


def measure(
    folder: Path,
    agents: int,
    seconds: float,
    repeats: int,
    highway_env: Callable[[int], Sample] | None,
    done: Callable[[], object],
    options: Sequence[str] = (),
) -> list[Sample]:
    """Measures everything `repeats` times with one number of agents.

    Args:
        folder: for the scenario and the records.
        agents: number of agents.
        seconds: simulated time of a run, history included [s].
        repeats: number of repetitions.
        highway_env: times highway-env with a number of agents; None to leave it out.
        done: called after each repetition.
        options: further ones of the launcher, for the runs over DDS.

    Raises:
        InputError: a run failed.
    """
    scenario = write_scenario(folder, agents, seconds)
    samples = []
    for _ in range(repeats):
        sample: Sample = {}
        for sumo in (True, False):
            context = multiprocessing.get_context("spawn")  # libsumo allows one simulation per process
            with ProcessPoolExecutor(1, mp_context=context) as process:
                sample |= process.submit(time_in_process, scenario, sumo=sumo).result()
        sample |= time_graph(scenario, folder / "bag", options)
        sample |= time_recording(folder / "bag", folder / "again")
        sample |= highway_env(agents) if highway_env else {}
        samples.append(sample | {name: sample[a] / sample[b] for name, (a, b) in RATIOS.items() if a in sample})
        done()
    return samples


def spread(samples: Sequence[Sample], name: str) -> str:
    """Returns the figure `name` over the repetitions, as `median (minimum to maximum)`."""
    values = [sample[name] for sample in samples]
    return f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def table_rows(by_agents: dict[int, list[Sample]]) -> Iterator[list[str]]:
    """Yields rows of the table: name, and figure for each number of agents; a dash if it was not measured."""
    path = dict.fromkeys(name for samples in by_agents.values() for name in samples[0] if name.startswith(PATH))
    for name in (*PARTS, IN_PROCESS, WITHOUT_SUMO, GRAPH, *path, FIRST_STEP, HIGHWAY_ENV, *RATIOS):
        if any(name in samples[0] for samples in by_agents.values()):
            cells = (spread(samples, name) if name in samples[0] else "-" for samples in by_agents.values())
            yield [name if name in RATIOS else f"{name}, ms", *cells]


def execute(program: Path, *arguments: str) -> str:
    """Runs a program, outside of this process's ROS domain, and returns its standard output.

    Raises:
        InputError: it cannot be run, or fails.
    """
    own = {key: value for key, value in os.environ.items() if key != "ROS_DOMAIN_ID"}
    try:
        ended = subprocess.run([program, *arguments], capture_output=True, text=True, check=False, env=own)
    except OSError as error:
        raise InputError(f"{program}: cannot be run: {error.strerror or error}") from error
    if ended.returncode != 0:
        raise InputError(f"{program.name} ended with status {ended.returncode}: {ended.stderr.strip()[-500:]}")
    return ended.stdout
