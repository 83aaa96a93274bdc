"""The space of a search: what may change in a scenario, proposals of changes, and how far from reality they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from math import hypot
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from litsim_eval.search.people import PARAMETERS, Habit, Parameter, People
from litsim_eval.search.places import agents_by_act, headway, headway_bounds
from litsim_sim.core.scene import STEP_S, IntArray
from litsim_sim.scenario.changes import Change, changes_of
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

if TYPE_CHECKING:
    from optuna.trial import BaseTrial

DISTANCE_MAX = 6.0
"""Largest distance of a parameter within which a search looks, unless the parameter's bounds are nearer."""
LOOK_S = 12.0  # [s] after the history within which an agent begins to act
LAST_S = 2.0  # [s] before the end after which none begins
PACE_S = 6.0  # [s] for which an agent keeps another pace
SMALLEST = 0.05  # distance below which a parameter is left as recorded
CLEAR = 0.4  # share of a bound from which on clear changes are
OTHERS = 0.25  # share of clear proposals in which one more thing changes than what an agent does
WITHIN_TRIES = 10
NOTHING = "nothing"
"""Kind of act of proposals in which no agent acts."""
OF_ALL = ("start.faster", "start.left", "signals.later_s", "delay.later_s", "noise.sigma_m")
"""Parameters that all proposals have."""
USUAL = {
    "brake": {"duration_s": 1.0, "deceleration": 1.0},
    "cut_in": {"duration_s": 4.0},
    "cut_out": {"duration_s": 4.0},
    "pace": {"duration_s": PACE_S},
}
"""What agents do where a parameter of the act does not vary."""
UNTIMED = (NOTHING, "enter", "inattentive")
"""Acts without a time of their own."""
WAITING = ("brake", "cut_in", "cut_out")
"""Acts that wait until the ego is as near as it is without changes."""
ALWAYS_ACTS = ("cut_in", "cut_out")
"""Acts that are some even if all their parameters are as usual."""


@dataclass(frozen=True)
class Proposal:
    """Changes of a scenario.

    Attributes:
        act: kind of what an agent does, or :data:`NOTHING`.
        agent: which agent; -1 for none.
        begin_s: when it begins [s].
        z: by parameter, the distance in standard deviations; its sign is the direction.
    """

    act: str = NOTHING
    agent: int = -1
    begin_s: float = 0.0
    z: Mapping[str, float] = field(default_factory=dict)

    @property
    def main(self) -> list[str]:
        """The parameters of the act; without an act, that which changes most."""
        of_act = [name for name in self.z if name not in OF_ALL]
        return of_act or sorted(self.z, key=lambda name: abs(self.z[name]))[-1:]

    @property
    def cause(self) -> str:
        """What the main change is, with a minus where it goes down."""
        minus = "-" if any(self.z[name] < 0.0 for name in self.main) else ""
        return minus + (self.act if self.act != NOTHING else "".join(self.main))

    def scaled(self, factor: float) -> Proposal:
        """Returns the same with its distances multiplied."""
        return replace(self, z={name: value * factor for name, value in self.z.items()})


@dataclass(frozen=True)
class Space:
    """What may change in a scenario.

    Attributes:
        scenario: as recorded, with its ego.
        driven: where all drive, the ego included, if nothing is changed: the log, until that run is made.
        parameters: those that may vary, by name.
        agents: by kind of act, the agents that may act so, the nearest to the ego first, each with the steps at which
            it is where such an act concerns the ego.
        people: what people did.
        steps: first and last step at which an agent begins to act.
    """

    scenario: Scenario
    driven: Log
    parameters: Mapping[str, Parameter]
    agents: Mapping[str, Mapping[int, IntArray]]
    people: People
    steps: tuple[int, int]

    @classmethod
    def of(cls, scenario: Scenario, people: People, only: Sequence[str] = (), driven: Log | None = None) -> Space:
        """Returns the space of a scenario in which agents act where they and the ego are if nothing is changed.

        Args:
            scenario: as recorded.
            people: what they did.
            only: kinds of change, or parameters, that vary; none for all.
            driven: where all drove in the run without changes; None for the log.
        """
        driven = driven or scenario.log
        first = scenario.history_steps
        last = max(first, min(first + round(LOOK_S / STEP_S), scenario.total_steps - round(LAST_S / STEP_S)))
        taken = {act.agent for _, act in scenario.actors}  # their changes stay, one more would contradict them
        agents = {
            act: {agent: steps for agent, steps in of_act.items() if agent not in taken}
            for act, of_act in agents_by_act(scenario, driven, np.arange(first, min(last + 1, driven.steps))).items()
        }
        possible = {"start", "delay", "noise", *(act for act in agents if agents[act])}
        possible |= {"signals"} if scenario.signals else set()
        usable = {
            parameter.name: parameter
            for parameter in PARAMETERS
            if parameter.kind in possible
            and (parameter.name in only or parameter.kind in only or not (only or parameter.declared))
        }
        acts = {parameter.kind for parameter in usable.values()}
        agents = {act: of_act for act, of_act in agents.items() if act in acts}
        return cls(scenario, driven, usable, agents, people, (first, last))

    def habit(self, name: str) -> Habit:
        """Returns the habit by which a parameter is measured."""
        return self.people.habit(self.parameters[name])

    def bounds(self, name: str) -> tuple[float, float]:
        """Returns the least and greatest distance of a parameter, by its bounds and DISTANCE_MAX."""
        parameter, habit = self.parameters[name], self.habit(name)
        bound = parameter.high if habit.values[-1] > habit.values[0] else parameter.low
        high = min(DISTANCE_MAX, habit.distance(bound))
        return (-high if parameter.signed else 0.0), high

    @property
    def acts(self) -> list[str]:
        """Kinds of act of which there are proposals."""
        return [*([NOTHING] if self.varied(NOTHING) else []), *self.agents]

    def strata(self) -> Iterator[tuple[str, int]]:
        """Yields acts in turn without end, each with the nearest agent that may act so, then the next."""
        for k in count():
            for act in self.acts:
                agents = [-1] if act == NOTHING else list(self.agents[act])
                yield act, agents[k % len(agents)]

    def suggested(self, trial: BaseTrial) -> Proposal:
        """Returns what an optimiser proposes."""
        act = trial.suggest_categorical("act", self.acts)
        agent, begin = -1, 0
        if act != NOTHING:
            agent = trial.suggest_categorical(f"{act}.agent", list(self.agents[act]))
            if act not in UNTIMED:
                begin = trial.suggest_int(f"{act}.begin", *self.steps)
        return self._proposal(
            act, agent, begin, {name: trial.suggest_float(name, *self.bounds(name)) for name in self.varied(act)}
        )

    def drawn(self, random: np.random.Generator) -> Proposal:
        """Returns a draw from the declared distribution: acts, agents and moments equally often, normal distances."""
        act = str(random.choice(self.acts))
        agent = -1 if act == NOTHING else int(random.choice(list(self.agents[act])))
        begin = int(random.integers(*self.steps, endpoint=True))
        return self._proposal(act, agent, begin, {name: random.normal() for name in self.varied(act)})

    def clear(self, random: np.random.Generator, act: str, agent: int) -> Proposal:
        """Returns a draw with large distances.

        Most of what all proposals have is as recorded, so that few things change at once.
        """
        begin = 0 if act == NOTHING else int(random.choice(self.agents[act][agent]))
        z, names = {}, self.varied(act)
        main = [random.choice(names)] if act == NOTHING else [name for name in names if name not in OF_ALL]
        for name in names:
            low, high = self.bounds(name)
            if name in main or random.random() < OTHERS:
                z[name] = random.uniform(CLEAR, 1.0) * (high if random.random() < 0.5 else low or high)
        return self._proposal(act, agent, begin, z)

    def within(self, proposal: Proposal, distance: float) -> Proposal | None:
        """Returns the same, made smaller until it is within `distance`; None where that takes all of it."""
        for _ in range(WITHIN_TRIES):
            far = self.distance(proposal)
            if far <= distance:
                return proposal if far > 0.0 else None
            proposal = proposal.scaled(min(0.95, distance / far))
        return None

    def values_of(self, proposal: Proposal) -> dict[str, Any]:
        """Returns parameters for an optimiser with which :meth:`suggested` returns `proposal`."""
        act, values = proposal.act, dict[str, Any](act=proposal.act)
        if act != NOTHING:
            values[f"{act}.agent"] = proposal.agent
        if act not in UNTIMED:
            values[f"{act}.begin"] = round(proposal.begin_s / STEP_S)
        return values | {name: proposal.z.get(name, 0.0) for name in self.varied(act)}

    def _proposal(self, act: str, agent: int, begin: int, z: Mapping[str, float]) -> Proposal:
        """Returns a proposal at the nearest moment that concerns the ego, with distances within their bounds."""
        inside = {}
        for name, value in z.items():
            low, high = self.bounds(name)
            inside[name] = float(np.clip(abs(value) if low == 0.0 else value, low, high))
        return self.placed(Proposal(act, agent, round(begin * STEP_S, 1), inside))

    def placed(self, proposal: Proposal) -> Proposal:
        """Returns the same at the nearest moment at which the agent is where such an act concerns the ego."""
        if proposal.act in UNTIMED:
            return replace(proposal, begin_s=0.0)
        steps = self.agents[proposal.act][proposal.agent]
        nearest = steps[np.abs(steps - round(proposal.begin_s / STEP_S)).argmin()]
        return replace(proposal, begin_s=round(float(nearest) * STEP_S, 1))

    def varied(self, act: str) -> list[str]:
        """Returns the names of the parameters that proposals with this act have."""
        of_act = [
            name for name, parameter in self.parameters.items() if parameter.kind == act and name != "cut_in.headway_s"
        ]
        return of_act + [name for name in OF_ALL if name in self.parameters]

    def distances(self, proposal: Proposal) -> dict[str, float]:
        """Returns how far a proposal is from reality by parameter, without those that are as recorded.

        Where an agent acts, `KIND.occurs` is how far it is that an agent does such a thing at all.
        """
        act, far = proposal.act, {name: abs(z) for name, z in proposal.z.items() if abs(z) >= SMALLEST}
        for name, value in self.values(proposal).items():
            if name in far and self.parameters[name].step >= STEP_S:  # as it is rounded
                far[name] = self.habit(name).distance(abs(value))
        if act in ALWAYS_ACTS or any(far.get(name) for name in proposal.z if name not in OF_ALL):
            if act in self.people.rates:
                first, last = self.steps
                far[f"{act}.occurs"] = self.people.rates[act].distance((last - first + 1) * STEP_S)
            if act == "cut_in":
                far["cut_in.headway_s"] = self.people.habits["headway_left_s"].distance(self._headway_s(proposal))
        return {name: distance for name, distance in far.items() if distance > 0.0}

    def acts_in(self, proposal: Proposal) -> bool:
        """Returns whether an agent acts; where its act is as recorded it does not, and stays on its log."""
        return any(name.startswith(f"{proposal.act}.") for name in self.distances(proposal))

    def distance(self, proposal: Proposal) -> float:
        """Returns how far a proposal is from reality: the norm of its distances."""
        return hypot(*self.distances(proposal).values())

    def values(self, proposal: Proposal) -> dict[str, float]:
        """Returns the values of the parameters of a proposal, in their units."""
        values = {}
        for name, z in proposal.z.items():
            parameter = self.parameters[name]
            size = float(np.clip(self.habit(name).value(abs(z)), max(parameter.low, 0.0), parameter.high))
            value = float(np.copysign(size, z)) if parameter.signed else size
            values[name] = round(round(value / parameter.step) * parameter.step, 3)
        return values

    def changes(self, proposal: Proposal) -> list[Change]:
        """Returns the changes of the scenario that a proposal stands for."""
        small = {name for name, z in proposal.z.items() if abs(z) < SMALLEST and name in OF_ALL}
        value = {name: 0.0 if name in small else v for name, v in self.values(proposal).items()}

        def of_kind(kind: str) -> dict[str, float]:
            return {name.partition(".")[2]: v for name, v in value.items() if self.parameters[name].kind == kind}

        act, fields = proposal.act, list[dict[str, Any]]()
        if self.acts_in(proposal):
            when = {} if act in UNTIMED else {"begin_s": proposal.begin_s}
            change: dict[str, Any] = {
                "kind": act,
                "agent": proposal.agent,
                **when,
                **USUAL.get(act, {}),
                **of_kind(act),
            }
            if act in WAITING:
                change["headway_s"] = headway_bounds(act, self._headway_s(proposal))
            if act == "pace":
                change["factor"] = round(1.0 + change["factor"], 3)
            if act == "enter":
                log = self.scenario.log
                earliest = (self.scenario.history_steps + 1 - int(log.first_step[log.row(proposal.agent)])) * STEP_S
                change["later_s"] = round(max(change["later_s"], earliest), 1)
            fields.append(change)
        for kind in dict.fromkeys(name.partition(".")[0] for name in OF_ALL):
            if any((own := of_kind(kind)).values()):
                fields.append({"kind": kind} | ({"agent": self.scenario.ego_id} if kind == "start" else {}) | own)
        return changes_of(fields)

    def scenario_file(self, proposal: Proposal, name: str) -> str:
        """Returns the YAML text of the scenario with the changes of a proposal."""
        file, changes = self.scenario.file, self.changes(proposal)
        values = file.model_dump(mode="json", exclude_defaults=True, exclude={"egos", "tuning"})
        text = "; ".join(change.text for change in changes) or "as recorded"
        before = [change.model_dump(mode="json") for change in file.changes]
        values |= {
            "name": name,
            "description": f"{file.name} with changes: {text}.",
            "ego": file.ego,
            "changes": before + [change.model_dump(mode="json") for change in changes],
        }
        return yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=120)

    def _headway_s(self, proposal: Proposal) -> float:
        """Returns the headway of the ego to the agent when its act begins, as both drive without changes [s]."""
        return headway(self.driven, self.scenario.ego_id, proposal.agent, round(proposal.begin_s / STEP_S))
