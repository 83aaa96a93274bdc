"""The loop: runs of one scenario or of several together, step by step, in this process and without ROS.

Stages and drivers of the ego are plug-ins, so that this module imports no package above its own.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

from litsim_sim.core import plugins
from litsim_sim.core.latency import NONE, Delayed, latency_in, without_latency
from litsim_sim.core.parameters import Parameters
from litsim_sim.core.scene import AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import BRIDGE, CONFLICT, EGO, POLICY, POLICY_STAGES, PREDICTOR
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.kernels.compiled import load_kernels
from litsim_sim.kernels.garbage import spared_from_collection
from litsim_sim.scenario.batched import BatchedScenario
from litsim_sim.scenario.perception import Perception
from litsim_sim.scenario.policies import REPLAY, class_of_policy, setup_of
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.scenario.setting import Setting
from litsim_sim.world.world import World

if TYPE_CHECKING:
    from litsim_sim.world.sumo import SumoMirror

PASSIVE = (REPLAY, None)
"""Policies with which nobody is taken over."""
Stages = Mapping[str, Callable[..., Any]]
"""Constructors of stages, by name."""


@dataclass(frozen=True)
class Step:
    """A step and the answers to it.

    Attributes:
        table: all agents; those of all scenarios where several are stepped together.
        takeovers, controls: of the agents off their logs; None with policy replay.
        egos: the command of the ego of every scenario.
        running: numbers of the scenarios that are not over.
        stage_s: time of each stage, by the clock of the simulation [s].
    """

    table: AgentTable
    takeovers: TakeoverTable | None
    controls: ControlTable | None
    egos: tuple[EgoCommand, ...]
    running: tuple[int, ...]
    stage_s: dict[str, float]

    @property
    def ego(self) -> EgoCommand:
        """The command of the ego of a single scenario."""
        (command,) = self.egos
        return command


Observer = Callable[[Step], object]
"""What is called with every step once it is answered."""


class Driver(Protocol):
    """What drives an ego, such as a `litsim_policy.ego.ego.Ego`."""

    @abstractmethod
    def plan(self, table: AgentTable) -> EgoCommand:
        """Returns the command for the step of `table`; called once per step, in order."""


class Simulation:
    """Runs of one scenario, or of several that are stepped together without influence on each other.

    Step 0 is there from the beginning. Each call of :meth:`step` answers the present step and goes on to the next one::

        simulation = Simulation(Scenario.load("demo"), ego="idm")
        while not simulation.ended:
            table = simulation.step()

    Whoever drives agents or egos by other means, such as a policy in training or nodes of a graph, gives :meth:`step`
    their commands.

    Attributes:
        scenarios: the scenarios, one at least.
        observers: called with each answered step, in order.
        world: the world that is stepped.
        table: all agents at the present step; of a sequence of scenarios, with the ids of :attr:`batch`.
        batch: the scenarios as one, where a sequence was given; None for a scenario by itself.
        summaries: summary of each run that is over (:meth:`.World.summary`), by number of its scenario.

    Raises:
        InputError: ego or policy are unknown, a parameter is unknown to its stage or invalid, or a stage cannot be
            built.
        ValueError: the scenarios differ in :func:`litsim_sim.scenario.batched.kind`, or in number from the egos, or
            the policy cannot drive the agents of several.
    """

    def __init__(
        self,
        scenario: Scenario | Sequence[Scenario],
        ego: str | Driver | Sequence[str | Driver] | None = None,
        policy: str | type[Any] | None = "litsim",
        parameters: Parameters | None = None,
        observers: Iterable[Observer] = (),
        *,
        full_length: bool = False,
        mirror: SumoMirror | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Set up the runs, at step 0.

        Args:
            scenario: one, or several of one kind.
            ego: name of an installed driver, or a driver, for each scenario or for all; None if the caller of
                :meth:`step` gives the egos' commands.
            policy: of the background: the name of an installed one or of a setup, or a class of policies, made as
                ``cls(scenario)``; None if only those agents are off their logs that the caller of :meth:`step` drives.
            parameters: of the stages, by stage and name, where they are not the defaults; and `latency` of the bridge,
                by which commands of the drivers count later.
            observers: see :attr:`observers`.
            full_length: whether runs go on to the ends of their scenarios, also once their egos have left or collided.
            mirror: SUMO's display of a single scenario; the caller closes it.
            clock: times the stages [s].
        """
        if isinstance(policy, str):
            setup = setup_of(policy)
            policy, parameters = setup.kind, setup.stage_parameters(parameters)
        self.scenarios = (scenario,) if isinstance(scenario, Scenario) else tuple(scenario)
        self.batch = None if isinstance(scenario, Scenario) else BatchedScenario.of(self.scenarios)
        self.observers = list(observers)
        self._setting: Setting = self.scenarios[0] if self.batch is None else self.batch
        if self.batch is not None and policy not in PASSIVE and not class_of_policy(policy).batched:
            raise ValueError(f"policy {policy} drives the agents of one scenario, expected one that is `batched`")
        self._policy, self._full_length, self._clock = policy, full_length, clock
        self._latency = latency_in(parameters)
        self._egos = _egos(ego, len(self.scenarios))
        names = dict.fromkeys(driver if isinstance(driver, str) else None for driver in self._egos or [None])
        self._stages = {name: configured(name, policy, parameters or {}) for name in names}
        self.world = World(self._setting, mirror, guard_entries=policy != REPLAY)
        self._takeovers: TakeoverTable | None = None
        self._begin()

    @classmethod
    def of(
        cls,
        plan: RunPlan,
        mirror: SumoMirror | None = None,
        ego: Driver | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> Simulation:
        """Returns the simulation of a plan; `ego`, if given, drives in place of the plan's."""
        return cls(plan.scenario, ego or plan.ego, plan.policy, plan.parameters, mirror=mirror, clock=clock)

    @property
    def running(self) -> tuple[int, ...]:
        """Numbers of the scenarios that are not over."""
        return tuple(number for number in range(len(self.scenarios)) if number not in self.summaries)

    @property
    def ended(self) -> bool:
        """Whether the last step of every scenario is answered."""
        return len(self.summaries) == len(self.scenarios)

    def reset(self) -> AgentTable:
        """Begin anew, independent of what was; return step 0. Drivers that were given as objects stay as they are."""
        if self._answered:
            self._begin()
        return self.table

    @property
    def takeovers(self) -> TakeoverTable | None:
        """The agents off their logs at the present step, and why; None where nobody is taken over whatever happens."""
        if self._takeovers is None and self._reaction is not None:
            self._takeovers = self._reaction.takeovers(self.table, self._marks)
        return self._takeovers

    def step(
        self, command: EgoCommand | Sequence[EgoCommand] | None = None, controls: ControlTable | None = None
    ) -> AgentTable:
        """Answer the present step, show it to the observers, and return the next one; after the last, this once more.

        Args:
            command: of the ego, or of the ego of each scenario; only if no driver was named.
            controls: of agents that the caller drives; the policy drives the other ones of :attr:`takeovers`.

        Raises:
            ValueError: the simulation has ended, a command lacks or is one too many, or commands or controls cannot be
                applied (:func:`litsim_sim.world.driven.check_answers`).
        """
        self._next(command, controls)
        return self.table

    def end(self, number: int) -> None:
        """End a scenario at the present step, before its last one; its agents leave the road."""
        self._answered = True
        self._summarise(number)
        self.table, before = self.world.drop(number), self.table
        if self._takeovers is not None:
            self._takeovers = self._takeovers.without(before.id[before.scene == number])

    def steps(self) -> Iterator[Step]:
        """Yields each step that is answered, from the present one to the last; raises as :meth:`step`."""
        with spared_from_collection():
            while not self.ended:
                yield self._next(None, None)

    def apart(self, step: Step) -> dict[int, Step]:
        """Returns the newest answered step by scenario, with the ids of the recordings, for scenarios not over in it.

        The times of the stages are divided equally.
        """
        if self.batch is None:
            return {0: step}
        tables = self.batch.tables(step.table)
        takeovers: Sequence[TakeoverTable | None] = [None] * len(tables)
        controls: Sequence[ControlTable | None] = [None] * len(tables)
        if self._reaction is not None and step.takeovers is not None and step.controls is not None:
            takeovers, controls = self._reaction.apart(step.takeovers, self.batch), self.batch.controls(step.controls)
        shares = {stage: wall / len(step.running) for stage, wall in step.stage_s.items()}
        return {k: Step(tables[k], takeovers[k], controls[k], (step.egos[k],), (0,), shares) for k in step.running}

    def _begin(self) -> None:
        """Make drivers and stages anew, and step 0."""
        setting = self._setting
        self._drivers = self._made_drivers() if self._egos else None
        stages = next(iter(self._stages.values()))
        self._reaction = None if self._policy in PASSIVE else Reaction(stages, self._policy, setting, self._clock)
        load_kernels()
        self.summaries: dict[int, dict[str, Any]] = {}
        self._delayed = [Delayed[EgoCommand](self._latency) for _ in self.scenarios]
        self._answered = False
        begin = self._clock()
        self._show(self.world.reset(), begin)

    def _show(self, table: AgentTable, begin: float) -> None:
        """Make `table` the present step, which the world has worked on since `begin` [s]."""
        self.table = table
        if self._egos:  # else others answer, and a caller who waits for them has time for the rest of the step's work
            self.world.catch_up()
        self._takeovers = None
        self._marks = {BRIDGE: self._clock() - begin}

    def _made_drivers(self) -> _Drivers:
        drivers = [
            self._stages[ego][EGO](scenario) if isinstance(ego, str) else ego
            for ego, scenario in zip(self._egos, self.scenarios, strict=True)
        ]
        if len(drivers) == 1:
            return _OneDriver(self.scenarios[0], self.batch, drivers[0])
        together: _Drivers = plugins.load(plugins.EGO_BATCHES, EGO)(self.batch, drivers)
        return together

    def _next(self, command: EgoCommand | Sequence[EgoCommand] | None, controls: ControlTable | None) -> Step:
        """Answer the present step and go on; return the answered step."""
        if self.ended:
            raise ValueError("the simulation has ended, expected reset() before another step")
        given = self._given(command)
        self._answered = True
        takeovers = self.takeovers
        if self._reaction is not None and takeovers is not None:
            controls = self._reaction.controls(self.table, takeovers, controls, self._marks)
        begin = self._clock()
        egos = given if self._drivers is None else tuple(self._drivers.plan(self.table, self.running))
        self._marks[EGO] = self._clock() - begin
        if self._latency != NONE and self._drivers is not None:
            egos = self._later(egos)
        step = Step(self.table, takeovers, controls, egos, self.running, self._marks)
        for observe in self.observers:
            observe(step)
        self._advance(step)
        return step

    def _later(self, egos: tuple[EgoCommand, ...]) -> tuple[EgoCommand, ...]:
        """Returns the commands in force at the present step, after the latency of the drivers' commands `egos`."""
        step, took = self.table.step, self._marks[EGO] / len(self.running)
        for number in self.running:
            self._delayed[number].put(step, egos[number], took, step)
        in_force = [delayed.in_force(step) or EgoCommand(step) for delayed in self._delayed]
        return tuple(replace(command, step=step) for command in in_force)

    def _given(self, command: EgoCommand | Sequence[EgoCommand] | None) -> tuple[EgoCommand, ...]:
        """Returns the commands that the caller gives; none if drivers were named."""
        given = () if command is None else (command,) if isinstance(command, EgoCommand) else tuple(command)
        expected = len(self.scenarios) if self._drivers is None else 0
        if len(given) != expected:
            raise ValueError(f"{len(given)} commands of egos were given, expected {expected}")
        return given

    def _advance(self, step: Step) -> None:
        """Go on from `step` to the next one, for the scenarios for which there is one."""
        begin = self._clock()
        over = [number for number in step.running if self._is_over(number)]
        for number in over:
            self._summarise(number)
        if self.ended:
            return
        for number in over:
            self.world.drop(number)
        controls = ControlTable.empty(step.table.step) if step.controls is None else step.controls
        self._show(self.world.step_batch(controls, step.egos), begin)

    def _is_over(self, number: int) -> bool:
        """Returns whether the present step is the last of a scenario."""
        is_left = self.world.ends[number] is not None and not self._full_length
        return is_left or self.table.step == self.scenarios[number].total_steps

    def _summarise(self, number: int) -> None:
        """Note that a scenario is over at the present step."""
        own = () if self.batch is None else (number, self.batch.recorded_id_in(number))
        self.summaries[number] = self.world.summary(*own)


def configured(
    ego: str | None, policy: str | type[Any] | None, parameters: Parameters
) -> dict[str, Callable[..., Any]]:
    """Returns the constructors of the stages of runs with this policy and this ego, by stage; no ego stage for None.

    Raises:
        InputError: there are parameters of a stage that takes no part, a parameter is unknown to its stage or invalid,
            or the ego is unknown.
    """
    parameters = without_latency(parameters)
    taking_part = () if policy in PASSIVE else POLICY_STAGES
    stages = (*taking_part, *(() if ego is None else (EGO,)))
    return plugins.configured_stages(stages, parameters, ego or "")


class Reaction:
    """The reaction of the background to a step: predictor, conflict and policy, one after the other."""

    def __init__(self, stages: Stages, policy: str | type[Any], scenario: Setting, clock: Callable[[], float]) -> None:
        """Build the stages by their constructors, for `policy` and `scenario`; `clock` [s] times them."""
        self._history_steps, self._clock = scenario.history_steps, clock
        self._predictor = stages[PREDICTOR](policy, scenario)
        self._manager = stages[CONFLICT](policy, scenario)
        self._policy = policy(scenario) if isinstance(policy, type) else stages[POLICY](policy, scenario)

    def takeovers(self, table: AgentTable, marks: dict[str, float]) -> TakeoverTable:
        """Returns takeovers at the step of `table`, once for each step; adds the stages' times [s] to `marks`."""
        begin = self._clock()
        forecast = self._forecast(table)
        forecast_at = self._clock()
        takeovers = self._manager.update(table, forecast)
        marks[PREDICTOR], marks[CONFLICT] = forecast_at - begin, self._clock() - forecast_at
        return takeovers

    def controls(
        self, table: AgentTable, takeovers: TakeoverTable, given: ControlTable | None, marks: dict[str, float]
    ) -> ControlTable:
        """Returns the controls that are `given`, and the policy's of the other agents of `takeovers`; adds its time."""
        begin = self._clock()
        if given is None:
            controls = self._policy.act(table, takeovers)
        else:
            controls = ControlTable.merged(given, self._policy.act(table, takeovers.without(given.id)))
        marks[POLICY] = self._clock() - begin
        return controls

    def apart(self, takeovers: TakeoverTable, batch: BatchedScenario) -> list[TakeoverTable]:
        """Returns the newest `takeovers` by scene of `batch`."""
        rounds = self._manager.iterations.tolist(), self._manager.converged.tolist()
        return [
            TakeoverTable(takeovers.step, own, iterations, converged)
            for own, iterations, converged in zip(batch.takeovers(takeovers.takeovers), *rounds, strict=True)
        ]

    def _forecast(self, table: AgentTable) -> Any:
        """Returns the forecast of a step; None in the history, in which no agent is driven and no forecast is read."""
        if table.step >= self._history_steps:
            return self._predictor.forecast(table)
        return self._predictor.observe(table)


class _Drivers(Protocol):
    """The drivers of the egos of all scenarios."""

    @abstractmethod
    def plan(self, table: AgentTable, scenes: Iterable[int]) -> Sequence[EgoCommand]:
        """Returns commands of all egos for the step of `table`; empty ones for scenarios that are not in `scenes`."""


class _OneDriver(_Drivers):
    """The driver of a single scenario's ego, told of other agents what the scenario's changes let it see."""

    def __init__(self, scenario: Scenario, batch: BatchedScenario | None, driver: Driver) -> None:
        self._perception, self._batch, self._driver = Perception(scenario), batch, driver

    def plan(self, table: AgentTable, scenes: Iterable[int]) -> Sequence[EgoCommand]:  # noqa: ARG002 - there is one
        """See :class:`_Drivers`."""
        own = table if self._batch is None else self._batch.table(0, table)
        return (self._driver.plan(self._perception.of(own)),)


def _egos(ego: str | Driver | Sequence[str | Driver] | None, count: int) -> tuple[str | Driver, ...]:
    """Returns what drives the egos of `count` scenarios; nothing if their commands are given."""
    if ego is None:
        return ()
    listed = tuple(ego) if isinstance(ego, Sequence) and not isinstance(ego, str) else (ego,) * count
    if len(listed) != count:
        raise ValueError(f"{len(listed)} egos for {count} scenarios, expected one or as many")
    return listed
