"""What people did: quantiles of recorded traffic, by which a change of a scenario is as far as it is unusual.

A distance is in standard deviations: a value that a share p of the recorded moments exceeds has the distance at which
a normal distribution has p beyond it, on both sides. So 2 is what one moment in 22 exceeds, 3 one in 370. Beyond that
the quantiles from 1.5 to 3 are prolonged by a straight line. That an agent does something at all is as far as the
share p of the agents in such a place that do so in the time in which the search lets it begin.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field
from scipy.ndimage import uniform_filter1d
from scipy.stats import norm

from litsim_data.mining.events import EventKind, Situation
from litsim_data.mining.mine import events_in
from litsim_eval.search.places import Places
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import RATE_HZ, STEP_S, FloatArray, IntArray
from litsim_sim.io.files import write_text
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario, packaged

PACKAGE, FILE = "litsim_eval", "search/people.yaml"
DISTANCES = np.arange(0.0, 3.01, 0.5)
"""Distances at which the quantiles of a habit are kept."""
PROLONGED_FROM = 3  # position in DISTANCES of the first of the two quantiles whose line is prolonged
MOMENTS_MIN = 10  # fewest moments of which quantiles are taken
BEGUN_MIN = 10  # fewest acts by which their rate is measured
AHEAD_S = 2.0  # [s] over which braking is measured
BRAKING, SMOOTHING = 0.5, 11  # [m/s2] from which on one brakes, of the mean over so many steps
NEARBY_M = 60.0  # [m] within which a leader is followed
DRIVING = 3.0  # [m/s] speed above which ratios of speeds are compared


class Habit(BaseModel):
    """How a quantity is distributed.

    Attributes:
        unit: its unit.
        moments: number of recorded moments.
        values: at :data:`DISTANCES`, ascending where large values are unusual, descending where small ones are.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    unit: str
    moments: int
    values: Annotated[list[float], Field(min_length=len(DISTANCES), max_length=len(DISTANCES))]

    @classmethod
    def of(cls, moments: FloatArray, unit: str, *, small: bool = False) -> Habit:
        """Returns the habit of values (n,), none negative; `small` if small ones are unusual, and not large ones."""
        share = 2.0 * norm.cdf(DISTANCES) - 1.0  # that is not beyond a distance
        values = np.quantile(moments, 1.0 - share if small else share)
        if not small:
            values[0] = 0.0  # no change is no distance
        slope = np.arange(len(values)) * 1e-6 * (-1.0 if small else 1.0)  # strictly monotonic
        return cls(unit=unit, moments=len(moments), values=[round(float(value), 6) for value in values + slope])

    def value(self, distance: float) -> float:
        """Returns the value at a distance."""
        if distance > DISTANCES[-1]:
            return self.values[-1] + (distance - float(DISTANCES[-1])) * self._slope
        return float(np.interp(distance, DISTANCES, self.values))

    def distance(self, value: float) -> float:
        """Returns the distance of a value; 0 for what is usual."""
        beyond = (value - self.values[-1]) / self._slope
        if beyond > 0.0:
            return float(DISTANCES[-1]) + beyond
        order = 1 if self._slope > 0.0 else -1
        return float(np.interp(value, self.values[::order], DISTANCES[::order]))

    @property
    def _slope(self) -> float:
        """Slope by which the values go on beyond the last."""
        return (self.values[-1] - self.values[PROLONGED_FROM]) / float(DISTANCES[-1] - DISTANCES[PROLONGED_FROM])


class Rate(BaseModel):
    """How often agents that were in the place of an act began to do so, all pairs of ego and agent together.

    Attributes:
        seconds: time for which agents were there.
        begun: number of acts that began there.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seconds: Annotated[int, Field(gt=0)]
    begun: Annotated[int, Field(gt=0)]

    def distance(self, seconds: float) -> float:
        """Returns how far it is that an agent that is there for so long does so, if it may at any time as well."""
        share = -np.expm1(-self.begun / self.seconds * seconds)
        return float(norm.isf(0.5 * share))


DECLARED = {
    name: Habit(unit=name[-1], moments=0, values=[float(z) for z in deviation * DISTANCES])
    for name, deviation in {
        "signals_s": 2.0,
        "delay_s": 0.1,
        "reaction_s": 0.4,
        "hidden_s": 0.5,
        "noise_m": 0.2,
    }.items()
}
"""Habits that no recording shows, by what a standard deviation is [s or m]."""


@dataclass(frozen=True)
class Parameter:
    """A quantity of a change that a search varies.

    Attributes:
        name: `kind.field`.
        unit: its unit.
        low, high: bounds; -high to high where it may go either way from 0.
        habit: by which its distance is measured.
        about: what it is.
        step: its values are multiples of this.
    """

    name: str
    unit: str
    low: float
    high: float
    habit: str
    about: str
    step: float = 0.001

    @property
    def kind(self) -> str:
        """The kind of change."""
        return self.name.partition(".")[0]

    @property
    def signed(self) -> bool:
        """Whether it may go either way from 0."""
        return self.low < 0.0

    @property
    def declared(self) -> bool:
        """Whether its distance is declared, as no recording shows what is usual. It varies only if it is named."""
        return self.habit in DECLARED


class People(BaseModel):
    """What people did in some recordings.

    Attributes:
        source: the recordings.
        habits: by name.
        rates: by kind of act; others need none, as every agent has some pace and some time of entry.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    source: str
    habits: dict[str, Habit]
    rates: dict[str, Rate]

    @classmethod
    def load(cls) -> People:
        """Reads the packaged quantiles."""
        return read_yaml(packaged(FILE, PACKAGE), cls)

    @classmethod
    def of(cls, scenarios: Sequence[str]) -> People:
        """Measures what people do in the recordings of `scenarios`; what is too rare there is as packaged.

        Raises:
            InputError: a scenario cannot be used.
        """
        loaded = [Scenario.load(name) for name in scenarios]
        situations = [Situation.of(scenario.log, scenario.lane_map) for scenario in loaded]
        packaged_people = cls.load() if packaged(FILE, PACKAGE).is_file() else cls(source="", habits={}, rates={})
        habits, rates = dict(packaged_people.habits), dict(packaged_people.rates)
        measured = [_moments(situation) for situation in situations]
        for name, (unit, small) in QUANTITIES.items():
            moments = np.concatenate([values[name] for values in measured])
            if len(moments) >= MOMENTS_MIN:
                habits[name] = Habit.of(moments, unit, small=small)
            elif name not in habits:
                raise InputError(f"{', '.join(scenarios)}: {len(moments)} moments of {name}, expected {MOMENTS_MIN}")
        counted = [_counts(situation) for situation in situations]
        for act in counted[0]:
            seconds, begun = (sum(numbers) for numbers in zip(*(rates_of[act] for rates_of in counted), strict=True))
            if begun >= BEGUN_MIN:
                rates[act] = Rate(seconds=seconds, begun=begun)
            elif act not in rates:
                raise InputError(f"{', '.join(scenarios)}: {act} began {begun} times, expected {BEGUN_MIN}")
        return cls(source=", ".join(scenario.file.name for scenario in loaded), habits=habits, rates=rates)

    def habit(self, parameter: Parameter) -> Habit:
        """Returns the habit by which a parameter is measured."""
        return self.habits.get(parameter.habit) or DECLARED[parameter.habit]

    def write(self, path: Path) -> None:
        """Writes the quantiles as YAML.

        Raises:
            Unwritable: `path` cannot be written.
        """
        write_text(path, yaml.safe_dump(self.model_dump(), sort_keys=False, default_flow_style=None, width=120))


QUANTITIES: Mapping[str, tuple[str, bool]] = {
    "deceleration": ("m/s2", False),
    "braking_s": ("s", False),
    "lane_change_s": ("s", True),
    "headway_left_s": ("s", True),
    "pace": ("", False),
    "entry_s": ("s", False),
    "speed": ("m/s", False),
    "lane_offset": ("m", False),
}
"""Quantities of :func:`_moments`: unit, and whether small values are the unusual ones."""


def _moments(situation: Situation) -> dict[str, FloatArray]:
    """Returns values (k,) of each of the :data:`QUANTITIES` in a log.

    - `deceleration`: mean over 2 s, of every vehicle once a second while it is slowing down.
    - `braking_s`: duration of each stretch with a deceleration of 0.5 m/s2 or more.
    - `lane_change_s`, `headway_left_s`: duration of lane changes, and headway that they leave to who is then behind.
    - `pace`, `speed`: how far the speed is from that of a leader within 60 m, as a share of that and in m/s.
    - `entry_s`: how far the time between two vehicles that enter the same lane is from the median of that lane.
    - `lane_offset`: distance of the middle of a vehicle from that of its lane.
    """
    log, lane_map = situation.log, situation.lane_map
    vehicle = ~log.obstacle
    valid, second = log.valid & vehicle[:, None], round(RATE_HZ)
    ahead = round(AHEAD_S / STEP_S)
    both = valid[:, :-ahead] & valid[:, ahead:]
    loss = np.where(both, log.speed[:, :-ahead] - log.speed[:, ahead:], 0.0)[:, ::second] / AHEAD_S
    _, begin, end = _brakings(log)
    changes = [event.numbers for event in events_in(situation, [EventKind.LANE_CHANGE])]
    follow = situation.following
    following = (valid & (follow.leader >= 0) & (follow.gap < NEARBY_M))[:, ::second]
    closing, own = follow.closing[:, ::second][following], log.speed[:, ::second][following]
    of_leader = own - closing
    entries = []
    first = log.first_step
    rows = (vehicle & (first > 0)).nonzero()[0]
    lane = lane_map.nearest(log.x[rows, first[rows]], log.y[rows, first[rows]], log.yaw[rows, first[rows]])
    for lane_row in np.unique(lane.lane):
        between = np.diff(np.sort(first[rows][lane.lane == lane_row])) * STEP_S
        entries.append(np.abs(between - np.median(between)) if len(between) > 1 else np.empty(0))
    x, y, yaw = (values[:, ::second][valid[:, ::second]] for values in (log.x, log.y, log.yaw))
    return {
        "deceleration": loss[loss > 0.0],
        "braking_s": (end - begin) * STEP_S,
        "lane_change_s": _numbers(changes, "duration_s"),
        "headway_left_s": _numbers(changes, "behind_headway_s"),
        "pace": np.abs(closing / np.maximum(of_leader, DRIVING))[of_leader > DRIVING],
        "entry_s": np.concatenate([np.empty(0), *entries]),
        "speed": np.abs(closing),
        "lane_offset": np.abs(lane_map.nearest(x, y, yaw).d),
    }


def _counts(situation: Situation) -> dict[str, tuple[int, int]]:
    """Returns by kind of act for how many seconds agents were in its place, and how many acts began there.

    Each second and each act counts for every ego to which the agent is in that place. An agent cuts in if it begins to
    change to the side where the ego is, and cuts out if it begins to change to any side.
    """
    log, counts = situation.log, Counter[str]()
    vehicle = log.valid & ~log.obstacle[:, None]
    everyone = np.arange(len(log.ids))

    def seen(step: int) -> Places:
        egos = everyone[vehicle[:, step]]
        return Places.of(log, egos, np.full(len(egos), step))

    for step in range(0, log.steps, round(RATE_HZ)):
        place = seen(step)
        counts["leading"] += int(place.leading.sum())
        counts["beside"] += int(place.beside.sum())
    for row, begin, _ in np.transpose(_brakings(log)).tolist():
        counts["brake"] += int(seen(begin).leading[row].sum())
    for change in situation.changes:
        place = seen(change.begin)
        to_ego = (place.left[change.agent] < 0.0) == change.left
        counts["cut_in"] += int((place.beside[change.agent] & to_ego).sum())
        counts["cut_out"] += int(place.leading[change.agent].sum())
    places = {"brake": "leading", "cut_in": "beside", "cut_out": "leading"}
    return {act: (counts[place], counts[act]) for act, place in places.items()}


def _brakings(log: Log) -> tuple[IntArray, IntArray, IntArray]:
    """Returns rows, first steps and ends (k,) of the stretches in which vehicles brake."""
    braking = uniform_filter1d(log.acceleration, SMOOTHING, axis=1) <= -BRAKING
    braking &= log.valid & ~log.obstacle[:, None]
    edges = np.diff(np.pad(braking.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, begin = (edges == 1).nonzero()
    return rows, begin, (edges == -1).nonzero()[1]


def _numbers(events: Sequence[Mapping[str, object]], name: str) -> FloatArray:
    """Returns the measure `name` of those of `events` that have it."""
    return np.array([value for event in events if isinstance(value := event.get(name), float)], np.float64)


PARAMETERS = (
    Parameter("brake.deceleration", "m/s²", 0.1, 6.0, "deceleration", "how hard an agent brakes"),
    Parameter("brake.duration_s", "s", 0.3, 6.0, "braking_s", "how long"),
    Parameter("cut_in.duration_s", "s", 1.0, 8.0, "lane_change_s", "how long an agent takes to cut in"),
    Parameter("cut_in.headway_s", "s", 0.0, 5.0, "headway_left_s", "headway left; by who and when"),
    Parameter("cut_out.duration_s", "s", 1.0, 8.0, "lane_change_s", "how long an agent takes to cut out"),
    Parameter("pace.factor", "", -0.7, 0.7, "pace", "how much faster or slower an agent drives"),
    Parameter("enter.later_s", "s", -4.0, 4.0, "entry_s", "how much later an agent enters", step=0.1),
    Parameter("start.faster", "m/s", -6.0, 6.0, "speed", "how much faster the ego starts"),
    Parameter("start.left", "m", -1.2, 1.2, "lane_offset", "how far beside its place it starts"),
    Parameter("signals.later_s", "s", -10.0, 10.0, "signals_s", "how much later signals change"),
    Parameter("delay.later_s", "s", 0.0, 1.0, "delay_s", "latency added to the ego", step=0.1),
    Parameter("inattentive.later_s", "s", 0.0, 2.0, "reaction_s", "how much later an agent reacts", step=0.1),
    Parameter("hide.duration_s", "s", 0.1, 3.0, "hidden_s", "how long the ego is not told of an agent"),
    Parameter("noise.sigma_m", "m", 0.0, 1.0, "noise_m", "error of the positions that the ego is told"),
)
"""All parameters of a search. Who acts and when has no distance: every agent and moment is as usual as another."""
