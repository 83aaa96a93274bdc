"""Runs of encounters in process: what the agent does when the policy of a run drives it."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field

import numpy as np

from litsim_data.encounters.encounter import Encounter
from litsim_eval.runs.batched import BATCH_MAX, batch_simulation, batchable, portions
from litsim_sim.core.errors import reason
from litsim_sim.core.geometry import boxes_overlap
from litsim_sim.core.parameters import Parameters
from litsim_sim.core.scene import STEP_S, AgentTable, Controller
from litsim_sim.scenario.encounter_note import Track
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.simulation import Simulation

EGO = "track"
"""The ego of all runs: it drives what the opponent truly did."""


@dataclass(frozen=True)
class Setup:
    """What drives the agents.

    Attributes:
        name: unique name in tables and files.
        policy: name of the policy.
        parameters: of its stages.
    """

    name: str
    policy: str
    parameters: Parameters = field(default_factory=dict)


@dataclass(frozen=True)
class Drive:
    """What the agent of an encounter did in a run.

    Attributes:
        track: from step 0 on; shorter than the record if the agent or the ego left the road before its end.
        taken_over_s: time from the onset until it left its log [s]; None if it never did.
        contact: whether it touched another agent from the onset on, which it had not touched before.
    """

    track: Track
    taken_over_s: float | None
    contact: bool


@dataclass(frozen=True)
class RunKey:
    """A run that is asked for, by the positions of its setup and its encounter, and the number of its driver."""

    setup: int
    encounter: int
    driver: int


DriveOrReason = Drive | str
"""What was driven in a run, or the reason in one line why there is none."""


@dataclass(frozen=True)
class Task:
    """All runs that are asked for: each encounter by each setup, several times with other draws of the drivers."""

    encounters: Sequence[Encounter]
    setups: Sequence[Setup]
    drivers: int = 1

    def __len__(self) -> int:
        return len(self.encounters) * len(self.setups) * self.drivers

    def jobs(self) -> list[tuple[RunKey, ...]]:
        """Returns the runs in portions that can mostly be stepped together."""
        order = sorted(range(len(self.encounters)), key=self._alike)
        return [
            job
            for setup in range(len(self.setups))
            for job in portions([RunKey(setup, own, k) for k in range(self.drivers) for own in order], BATCH_MAX)
        ]

    def plan(self, run: RunKey) -> RunPlan:
        """Returns the plan of `run`; its driver is the number of the draw."""
        scenario, setup = self.encounters[run.encounter].scenario, self.setups[run.setup]
        drawn = scenario.around(None, None, draw=run.driver)
        return RunPlan(drawn, EGO, setup.policy, setup.parameters)

    def _alike(self, encounter: int) -> tuple[str, int, int]:
        """Returns what has to be equal for two encounters to be stepped together, and their lengths."""
        scenario = self.encounters[encounter].scenario
        return str(scenario.net_path), scenario.history_steps, scenario.total_steps


def run_task(task: Task, processes: int) -> Generator[tuple[RunKey, DriveOrReason], None, None]:
    """Yields each run of `task` with its outcome as soon as it is driven, in any order, by several processes."""
    context = multiprocessing.get_context("fork")  # the copies share the encounters
    with ProcessPoolExecutor(processes, context, _begin, (task,)) as pool:
        jobs = [pool.submit(_drive_job, job) for job in task.jobs()]
        try:
            for job in as_completed(jobs):
                yield from job.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def drive(task: Task, runs: Sequence[RunKey]) -> list[DriveOrReason]:
    """Returns the outcomes of `runs` of `task` in this process, driven together where that is possible.

    Runs that were driven together with one that fails are repeated alone.
    """
    plans = {number: task.plan(run) for number, run in enumerate(runs)}
    encounters = [task.encounters[run.encounter] for run in runs]
    outcomes: dict[int, DriveOrReason] = {}
    for together in batchable(plans):
        outcomes |= _together({number: plans[number] for number in together}, encounters)
    alone = {number: _alone(plans[number], encounters[number]) for number in plans if number not in outcomes}
    return [(outcomes | alone)[number] for number in plans]


class Watch:
    """Notes what the agent of an encounter does while a run is stepped."""

    def __init__(self, encounter: Encounter) -> None:
        self._encounter = encounter
        self._states: list[tuple[float, float, float, float]] = []
        self._gone, self._contact = False, False
        self._touched: set[int] = set()  # before the onset
        self._taken_over: int | None = None

    def look(self, table: AgentTable) -> None:
        """Note the agent's state at the next step."""
        row = table.row(self._encounter.note.agent)
        self._gone |= row < 0
        if self._gone:
            return
        self._states.append((table.x[row], table.y[row], table.yaw[row], table.speed[row]))
        touching = set(table.id[_touching(table, row)].tolist())
        if table.step < self._encounter.note.onset_step:
            self._touched |= touching
            return
        self._contact |= bool(touching - self._touched)
        if self._taken_over is None and table.controller[row] == Controller.POLICY:
            self._taken_over = table.step - self._encounter.note.onset_step

    @property
    def drive(self) -> Drive:
        """What the agent has done so far."""
        taken_over = None if self._taken_over is None else self._taken_over * STEP_S
        return Drive(Track(*np.array(self._states, np.float64).T.copy()), taken_over, self._contact)


def _touching(table: AgentTable, row: int) -> np.ndarray:
    """Returns the mask (n,) of the agents that the one in `row` touches."""
    touching = boxes_overlap(
        table.x - table.x[row],
        table.y - table.y[row],
        table.yaw[row],
        table.yaw,
        (table.length[row], table.width[row]),
        (table.length, table.width),
    )
    touching[row] = False
    return touching


def _together(plans: Mapping[int, RunPlan], encounters: Sequence[Encounter]) -> dict[int, Drive]:
    """Returns what is driven in the runs of `plans`, by their keys; empty if one of them fails."""
    watches = {number: Watch(encounters[number]) for number in plans}
    order = list(plans)
    try:
        simulation = batch_simulation(list(plans.values()))
        for step in simulation.steps():
            for place, result in simulation.apart(step).items():
                watches[order[place]].look(result.table)
    except Exception:  # noqa: BLE001 - alone, each run reports its own error
        return {}
    return {number: watch.drive for number, watch in watches.items()}


def _alone(plan: RunPlan, encounter: Encounter) -> DriveOrReason:
    watch = Watch(encounter)
    try:
        for result in Simulation.of(plan).steps():
            watch.look(result.table)
    except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
        return reason(error)
    return watch.drive


_tasks: list[Task] = []


def _begin(task: Task) -> None:
    """Initialise a process of the pool."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the parent process ends this one
    _tasks.append(task)


def _drive_job(job: Sequence[RunKey]) -> list[tuple[RunKey, DriveOrReason]]:
    (task,) = _tasks
    return list(zip(job, drive(task, job), strict=True))
