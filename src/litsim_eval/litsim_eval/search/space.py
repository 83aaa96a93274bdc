"""The space of a search: what may change in a scenario, proposals of changes, and how far from reality they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from litsim_eval.search.people import DECLARED, PARAMETERS, Habit, Parameter, People
from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.changes import Change, changes_of
from litsim_sim.scenario.scenario import Scenario

if TYPE_CHECKING:
    from optuna import Trial

DISTANCE_MAX = 6.0
"""Largest distance of a parameter within which a search looks, unless the parameter's bounds are nearer."""
AGENTS_MAX = 6  # most agents of a kind of act
AHEAD_M, ENTER_M = 80.0, 60.0  # [m] ahead of the ego within which agents act, and around it those that enter
BESIDE = (1.8, 5.5)  # [m] to the side of the ego, where agents can cut in
SAME_LANE = 1.8  # [m] to the side of the ego up to which an agent is in its lane
LOOK_S = 12.0  # [s] after the history within which an agent begins to act
LAST_S = 2.0  # [s] before the end after which none begins
PACE_S = 6.0  # [s] for which an agent keeps another pace
SMALLEST = 0.05  # distance below which a parameter is left as recorded
AS_RECORDED = 0.5  # share of values that stay so where proposals are drawn anywhere
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

    def without(self, name: str) -> Proposal:
        """Returns the same with one parameter as recorded; a parameter of the act takes the act with it."""
        if _kind(name) == self.act:
            return Proposal(z={key: value for key, value in self.z.items() if key in OF_ALL})
        return replace(self, z={key: value for key, value in self.z.items() if key != name})

    def scaled(self, factor: float, only: str = "") -> Proposal:
        """Returns the same with its distances, or that of one parameter, multiplied."""
        return replace(self, z={key: value * (factor if only in ("", key) else 1.0) for key, value in self.z.items()})


@dataclass(frozen=True)
class Space:
    """What may change in a scenario.

    Attributes:
        scenario: as recorded, with its ego.
        parameters: those that may vary, by name.
        agents: by kind of act, the agents that may act so.
        people: what people did.
    """

    scenario: Scenario
    parameters: Mapping[str, Parameter]
    agents: Mapping[str, tuple[int, ...]]
    people: People

    @classmethod
    def of(cls, scenario: Scenario, people: People, only: Sequence[str] = ()) -> Space:
        """Returns the space of a scenario; `only` names kinds of change, or parameters, none for all."""
        agents = {act: ids for act, ids in _agents(scenario).items() if ids}
        if scenario.file.changes:  # those that it has stay, one more of an agent would contradict them
            taken = {act.agent for _, act in scenario.actors}
            agents = {act: tuple(i for i in ids if i not in taken) for act, ids in agents.items()}
        usable = {
            each.name: each
            for each in PARAMETERS
            if _kind(each.name) in (*agents, "start", "delay", "noise", *(["signals"] if scenario.signals else []))
            and (each.name in only or _kind(each.name) in only or not (only or each.declared))
        }
        acts = {_kind(name) for name in usable}
        return cls(scenario, usable, {act: ids for act, ids in agents.items() if act in acts and ids}, people)

    def habit(self, parameter: Parameter) -> Habit:
        """Returns the habit by which a parameter is measured."""
        return self.people.habits.get(parameter.habit) or DECLARED[parameter.habit]

    def range_of(self, parameter: Parameter) -> float:
        """Returns the largest distance of a parameter, by its bounds and DISTANCE_MAX."""
        habit = self.habit(parameter)
        bound = parameter.high if habit.values[-1] > habit.values[0] else parameter.low
        return min(DISTANCE_MAX, habit.distance(bound))

    def suggested(self, trial: Trial) -> Proposal:
        """Returns what an optimiser proposes."""
        act = trial.suggest_categorical("act", [NOTHING, *self.agents])
        z, agent, begin = {}, -1, 0.0
        if act != NOTHING:
            agent = trial.suggest_categorical(f"{act}.agent", list(self.agents[act]))
            if act not in UNTIMED:
                begin = trial.suggest_int(f"{act}.begin", *self.steps) * STEP_S
        for name in self.varied(act):
            low, high = self._bounds(name)
            z[name] = trial.suggest_float(name, low, high)
        return Proposal(act, agent, round(begin, 1), z)

    def drawn(self, random: np.random.Generator, *, anywhere: bool = False) -> dict[str, Any]:
        """Returns parameters for an optimiser that are drawn from the declared distribution.

        Acts, agents and moments are equally probable, distances normal within their bounds. Or uniform, `anywhere`,
        with half of the parameters that all proposals have as recorded, so that few things change at once.
        """
        act = str(random.choice([NOTHING, *self.agents]))
        values: dict[str, Any] = {"act": act}
        if act != NOTHING:
            values[f"{act}.agent"] = int(random.choice(self.agents[act]))
            if act not in UNTIMED:
                values[f"{act}.begin"] = int(random.integers(*self.steps, endpoint=True))
        for name in self.varied(act):
            low, high = self._bounds(name)
            drawn = random.uniform(low, high) if anywhere else random.normal()
            if anywhere and act != NOTHING and name in OF_ALL and random.random() < AS_RECORDED:
                drawn = 0.0
            values[name] = float(np.clip(abs(drawn) if low == 0.0 else drawn, low, high))
        return values

    def values_of(self, proposal: Proposal) -> dict[str, Any]:
        """Returns parameters for an optimiser with which :meth:`suggested` returns `proposal`."""
        act, values = proposal.act, dict[str, Any](act=proposal.act)
        if act != NOTHING:
            values[f"{act}.agent"] = proposal.agent
        if act not in UNTIMED:
            values[f"{act}.begin"] = round(proposal.begin_s / STEP_S)
        return values | {name: proposal.z.get(name, 0.0) for name in self.varied(act)}

    def varied(self, act: str) -> list[str]:
        """Returns the names of the parameters that proposals with this act have."""
        of_act = [name for name in self.parameters if _kind(name) == act and name != "cut_in.headway_s"]
        return of_act + [name for name in OF_ALL if name in self.parameters]

    @property
    def steps(self) -> tuple[int, int]:
        """First and last step at which an agent begins to act."""
        first = self.scenario.history_steps
        last = min(first + round(LOOK_S / STEP_S), self.scenario.total_steps - round(LAST_S / STEP_S))
        return first, max(first, last)

    def distances(self, proposal: Proposal) -> dict[str, float]:
        """Returns how far a proposal is from reality by parameter, without those that are as recorded."""
        far = {name: abs(z) for name, z in proposal.z.items() if abs(z) >= SMALLEST}
        for name, value in self.values(proposal).items():
            if name in far and self.parameters[name].step >= STEP_S:  # as it is rounded
                far[name] = self.habit(self.parameters[name]).distance(abs(value))
        far = {name: distance for name, distance in far.items() if distance > 0.0}
        if proposal.act == "cut_in" and (left := self._headway_left(proposal)) > 0.0:
            far["cut_in.headway_s"] = left
        return far

    def distance(self, proposal: Proposal) -> float:
        """Returns how far a proposal is from reality: the norm of its distances."""
        return hypot(*self.distances(proposal).values())

    def values(self, proposal: Proposal) -> dict[str, float]:
        """Returns the values of the parameters of a proposal, in their units."""
        values = {}
        for name, z in proposal.z.items():
            parameter = self.parameters[name]
            size = float(np.clip(self.habit(parameter).value(abs(z)), parameter.low, parameter.high))
            value = float(np.copysign(size, z)) if parameter.signed else size
            values[name] = round(round(value / parameter.step) * parameter.step, 3)
        return values

    def changes(self, proposal: Proposal) -> list[Change]:
        """Returns the changes of the scenario that a proposal stands for."""
        small = {name for name, z in proposal.z.items() if abs(z) < SMALLEST}
        value = {name: 0.0 if name in small and name in OF_ALL else v for name, v in self.values(proposal).items()}
        act, fields = proposal.act, list[dict[str, Any]]()
        if act != NOTHING:
            own = {name.partition(".")[2]: value[name] for name in value if _kind(name) == act}
            when = {} if act in UNTIMED else {"begin_s": proposal.begin_s}
            fields.append({"kind": act, "agent": proposal.agent} | when | USUAL.get(act, {}) | own)
            if act == "pace":
                fields[0]["factor"] = round(1.0 + own["factor"], 3)
            if act == "enter":
                log = self.scenario.log
                earliest = (self.scenario.history_steps + 1 - int(log.first_step[log.row(proposal.agent)])) * STEP_S
                fields[0]["later_s"] = round(max(own["later_s"], earliest), 1)
        start = {name: value.get(f"start.{name}", 0.0) for name in ("faster", "left")}
        if any(start.values()):
            fields.append({"kind": "start", "agent": self.scenario.ego_id, **start})
        for name in ("signals.later_s", "delay.later_s", "noise.sigma_m"):
            if value.get(name):
                kind, _, field = name.partition(".")
                fields.append({"kind": kind, field: value[name]})
        return changes_of(fields)

    def scenario_file(self, proposal: Proposal, name: str) -> str:
        """Returns the YAML text of the scenario with the changes of a proposal."""
        file, changes = self.scenario.file, self.changes(proposal)
        values = file.model_dump(mode="json", exclude_defaults=True, exclude={"egos", "tuning"})
        said = "; ".join(change.text for change in changes) or "as recorded"
        before = [change.model_dump(mode="json") for change in file.changes]
        values |= {
            "name": name,
            "description": f"{file.name} with changes: {said}.",
            "ego": file.ego,
            "changes": before + [change.model_dump(mode="json") for change in changes],
        }
        return yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=120)

    def _bounds(self, name: str) -> tuple[float, float]:
        bound = self.range_of(self.parameters[name])
        return (-bound if self.parameters[name].signed else 0.0), bound

    def _headway_left(self, proposal: Proposal) -> float:
        """Returns the distance of the headway that a cut-in leaves to the ego, as both are recorded when it begins."""
        log, step = self.scenario.log, round(proposal.begin_s / STEP_S)
        ego, other = log.row(self.scenario.ego_id), log.row(proposal.agent)
        if not (log.valid[ego, step] and log.valid[other, step]):
            return 0.0
        dx, dy = log.x[other, step] - log.x[ego, step], log.y[other, step] - log.y[ego, step]
        ahead, _ = to_body(np.array(dx), np.array(dy), log.yaw[ego, [step]])
        room = float(ahead[0]) - 0.5 * float(log.length[ego] + log.length[other])
        return self.people.habits["headway_left_s"].distance(max(room, 0.0) / max(float(log.speed[ego, step]), 1.0))


def _kind(name: str) -> str:
    """Returns the kind of change of a parameter."""
    return name.partition(".")[0]


def _agents(scenario: Scenario) -> dict[str, tuple[int, ...]]:
    """Returns by kind of act the ids of the vehicles that may act so, those that come nearest to the ego first."""
    log, ego = scenario.log, scenario.log.row(scenario.ego_id)
    first, last = scenario.history_steps, min(log.steps, scenario.history_steps + round(LOOK_S / STEP_S))
    steps = np.arange(first, last)
    valid = log.valid[:, steps] & log.valid[ego, steps]
    valid[ego] = False
    valid &= ~log.obstacle[:, None]
    dx, dy = log.x[:, steps] - log.x[ego, steps], log.y[:, steps] - log.y[ego, steps]
    ahead, left = to_body(dx, dy, np.broadcast_to(log.yaw[ego, steps], dx.shape))
    with_ego = np.cos(log.yaw[:, steps] - log.yaw[ego, steps]) > 0.7
    away = np.hypot(ahead, 3.0 * left)
    in_front = valid & with_ego & (ahead > 0.0) & (ahead < AHEAD_M)
    beside = in_front & (np.abs(left) > BESIDE[0]) & (np.abs(left) < BESIDE[1])
    around = valid & (np.abs(ahead) < AHEAD_M)
    entering = valid & (log.first_step > scenario.history_steps)[:, None] & (np.hypot(dx, dy) < ENTER_M)
    leading = in_front & (np.abs(left) < SAME_LANE)
    return {
        "brake": _nearest(log.ids, leading, away),
        "cut_in": _nearest(log.ids, beside, away),
        "cut_out": _nearest(log.ids, leading, away),
        "pace": _nearest(log.ids, around, away),
        "enter": _nearest(log.ids, entering, away),
        "inattentive": _nearest(log.ids, around, away),
        "hide": _nearest(log.ids, around & (ahead > 0.0), away),
    }


def _nearest(ids: IntArray, may: BoolArray, away: FloatArray) -> tuple[int, ...]:
    """Returns those of `ids` (n,) that ever may, by the mask `may` (n, steps), the nearest by `away` first."""
    least = np.where(may, away, np.inf).min(axis=1, initial=np.inf)
    order = np.argsort(least, kind="stable")[: min(AGENTS_MAX, int(np.isfinite(least).sum()))]
    return tuple(int(ids[row]) for row in order)
