"""The fields of `metrics.json` as types, as returned by :func:`litsim_eval.analysis.metrics.compute_metrics`.

A value of None means that there was nothing to measure. docs/metrics.md defines every field.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from itertools import chain
from math import inf
from types import NoneType, UnionType
from typing import Annotated, Any, TypedDict, Union, get_args, get_origin, get_type_hints, is_typeddict

from litsim_data.surrogates.safety import TTC_CRITICAL_S
from litsim_eval.analysis.comfort import BOUNDS
from litsim_eval.analysis.displacement import HORIZONS_S
from litsim_eval.analysis.metric import ADDED
from litsim_eval.analysis.motion_features import FEATURES, SIM_AGENTS
from litsim_sim.core import plugins
from litsim_sim.core.scene import Kind
from litsim_sim.ego_port.port import COUNTS

NEAR_MAX = 5
ANY_KEY = "*"
"""Placeholder in the name of a field for a key that depends on the run, such as a stage or a topic."""


@dataclass(frozen=True)
class Keys:
    """Annotation of a dictionary type with its keys; without it, they depend on the run."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class Between:
    """Annotation of a number type with its smallest and largest value."""

    low: float
    high: float


SHARE = Between(0.0, 1.0)
COUNT = Between(0.0, inf)
"""Range of integers and of lengths of lists: all integers in the tree are counts, ids, steps or seeds."""
Share = Annotated[float, SHARE]

Horizons = Annotated[dict[str, float | None], Keys(tuple(map(str, HORIZONS_S)))]
"""Values by horizon [s]; horizons beyond the end of the run are absent."""


class EndMetrics(TypedDict):
    """Why and when the run ended."""

    reason: str
    step: int
    time_s: float
    lane: str


class FaultMetrics(TypedDict):
    """Pairs with contacts that are not in the log, by fault."""

    background: int
    ego_avoidable: int
    ego_unavoidable: int


class DisplacementMetrics(TypedDict):
    """Displacement of each agent from its log."""

    agent_steps: Annotated[dict[str, int], Keys(tuple(map(str, HORIZONS_S)))]
    agents: list[dict[str, Any]]


class CollisionMetrics(TypedDict):
    """Contacts between agents."""

    agents: int
    pairs: int
    rate_all: Share | None
    rate_controlled: Share | None
    excess_agents: int
    excess_rate_all: Share | None
    excess_rate_controlled: Share | None
    ego_at_fault: int
    background_at_fault: int
    by_fault: FaultMetrics
    log_floor: int
    excess: int
    by_kind: Annotated[dict[str, int], Keys(tuple(kind.name.lower() for kind in Kind))]
    contacts: list[dict[str, Any]]
    ego_contacts: list[dict[str, Any]]


class DrivenMetrics(TypedDict):
    """How one vehicle drove."""

    off_road: Share | None
    over_edge: Share | None
    hard_brakes: int | None
    progress_m: float | None


class EgoMetrics(DrivenMetrics):
    """How the ego drove, and how the vehicle that it replaces drove in the recording."""

    progress_ratio: float | None
    log: DrivenMetrics


class DetectionMetrics(TypedDict):
    """How often the detection of conflicts iterated within a step."""

    max_iterations: int
    bound_hits: int


class HandbackMetrics(TypedDict):
    """Handbacks of agents to their logs."""

    count: int
    max_position_jump_m: float
    max_speed_jump_mps: float
    max_yaw_jump_rad: float
    residual_m: float | None
    max_residual_m: float | None
    log_position_jump_m: float
    log_speed_jump_mps: float
    log_yaw_jump_rad: float


class SafetyMetrics(TypedDict):
    """Surrogate safety measures of the ego."""

    min_ttc_s: float | None
    min_own_ttc_s: float | None
    ttc_below: Annotated[dict[str, Share | None], Keys(tuple(map(str, TTC_CRITICAL_S)))]
    min_headway_s: float | None
    max_drac_mps2: float
    min_pet_s: float | None
    careful_driver: list[dict[str, Any]]
    avoidable_contacts: int


class EgoComfort(TypedDict):
    """Comfort of the ego."""

    within: Annotated[dict[str, Share], Keys(tuple(BOUNDS))]
    hard_brakes: int


class Guard(TypedDict):
    """Commands that the safety layer changed."""

    count: int
    commands: int
    share: Share | None


class ControlledComfort(TypedDict):
    """Comfort of the agents ever under control; hard brakes begun under control, and those of the log meanwhile."""

    comfortable: Share | None
    hard_brakes: int
    hard_brakes_log: int
    guarded: Guard


class ComfortMetrics(TypedDict):
    """Comfort of the ego and of the agents under control."""

    ego: EgoComfort | None
    controlled: ControlledComfort


class RealismMetrics(TypedDict):
    """Likelihood of the motion of the agents ever under control."""

    score: float
    features: Annotated[dict[str, float], Keys(tuple(FEATURES))]
    traffic_lights: str
    agent_steps: int


class DriversMetrics(TypedDict):
    """How closely, hard and steadily some vehicles drive, and over how much of their time."""

    minutes: float
    following: int
    headway_s: float | None
    gap_m: float | None
    headway_below_half_s: Share | None
    ttc_below_3_s: Share | None
    accelerations: int
    braking_beyond_2_mps2: Share | None
    jerks: int
    jerk_mps3: float | None
    lane_changes: int | None
    lane_changes_per_minute: float | None


class TrafficMetrics(TypedDict):
    """Agents while a policy drives them, the logs of the same agents, and all of the log."""

    driven: DriversMetrics
    same_log: DriversMetrics
    log: DriversMetrics
    headway_ratio: float | None


class SimAgentsMetrics(TypedDict):
    """Likelihood of the log under the run, by groups of features and by feature."""

    score: float
    kinematic: float | None
    interaction: float | None
    map: float | None
    features: Annotated[dict[str, float | None], Keys(tuple(SIM_AGENTS))]
    agents: int


class ReactSimMetrics(TypedDict):
    """How safely and feasibly the background responds to the ego."""

    ego_contacts: int
    ego_short_ttc: int
    contact_share: Share | None
    off_road: Share | None
    wrong_way: Share | None
    acceleration_infeasible: Share | None
    curvature_infeasible: Share | None


class LockstepMetrics(TypedDict):
    """Completeness of a run."""

    missed: int
    gaps: int
    missed_by_topic: dict[str, int]
    ego_port: Annotated[dict[str, int | str | None], Keys((*COUNTS, "interface"))]


class Spread(TypedDict):
    """Smallest, median and largest of some compute times [ms]."""

    min: float
    median: float
    max: float


class TimingMetrics(TypedDict):
    """Wall time."""

    wall_s: float | None
    realtime_factor: float | None
    stage_ms: dict[str, Spread]
    path_ms: dict[str, Spread]


class SignalMetrics(TypedDict):
    """Passages of stop lines, and how many of them at red."""

    passed: int
    red_ego: int
    red_controlled: int
    red_log: int
    reds: list[dict[str, Any]]


class WorldMetrics(TypedDict):
    """Entries that the world delayed or omitted, and its deviation from SUMO."""

    late_entries: list[Any] | None
    never_entered: list[Any] | None
    sumo_deviation_m: float | None


class Metrics(TypedDict):
    """The whole tree."""

    run_id: str
    scenario: str
    ego: str
    policy: str
    seed: int
    steps: int
    total_steps: int
    ended: EndMetrics | None
    agents: int
    controlled_agents: int
    digest: str
    collision: CollisionMetrics
    reactive: bool
    collision_free: bool
    ade_controlled_m: Horizons
    ade_all_m: Horizons
    ade_ego_m: Horizons
    displacement: DisplacementMetrics
    ego_motion: EgoMetrics
    off_road_controlled: Share | None
    replay_error_max_m: float | None
    progress_m: float | None
    progress_controlled_m: float | None
    progress_log_m: float | None
    relevant_ratio: Share | None
    relevant_ratio_roi: Share | None
    takeovers: int
    false_alarms: int
    detection: DetectionMetrics
    ledger: list[dict[str, Any]]
    handback: HandbackMetrics
    safety: SafetyMetrics
    comfort: ComfortMetrics
    realism: RealismMetrics | None
    realism_near: float | None
    sim_agents: SimAgentsMetrics | None
    reactsim: ReactSimMetrics
    traffic: TrafficMetrics
    signals: SignalMetrics | None
    minimum_risk_s: float | None
    standoffs: list[dict[str, Any]]
    lockstep: LockstepMetrics
    timing: TimingMetrics
    world: WorldMetrics
    added: dict[str, float | None]
    valid: bool
    why: str


@dataclass(frozen=True)
class MetricField:
    """A field of `metrics.json`.

    Attributes:
        name: its path, joined by dots; :data:`ANY_KEY` stands for a key that depends on the run.
        kinds: possible types: `int`, `float`, `bool`, `str` or `list`.
        between: range of its value, or of its length as a list; None if unknown.
    """

    name: str
    kinds: frozenset[type]
    between: Between | None = None

    @property
    def counts(self) -> bool:
        """Whether bounds can be set on it: it is a number, or a list, by its length."""
        return bool(self.kinds & {int, float, list})

    def covers(self, name: str) -> bool:
        """Returns whether `name` names this field."""
        before, star, after = self.name.partition(ANY_KEY)
        if not star:
            return name == self.name
        return name.startswith(before) and name.endswith(after) and len(name) > len(before) + len(after)


def leaves(tree: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Returns the leaves of a tree of measures by their paths, joined by dots; a list is a leaf."""
    by_path: dict[str, Any] = {}
    for key, value in tree.items():
        by_path |= leaves(value, f"{above}{key}.") if isinstance(value, Mapping) else {f"{above}{key}": value}
    return by_path


@cache
def metric_fields() -> tuple[MetricField, ...]:
    """Returns every field that a run may have, in the order of `metrics.json`, with the installed added measures."""
    own = tuple(field for field in _fields(Metrics, "") if not field.name.startswith(f"{ADDED}."))
    return (*own, *(MetricField(f"{ADDED}.{name}", frozenset({float})) for name in plugins.names(plugins.METRICS)))


def find_field(name: str) -> MetricField:
    """Returns the field called `name`.

    Raises:
        ValueError: there is none; the message suggests similar names.
    """
    for field in metric_fields():
        if field.covers(name):
            return field
    raise ValueError(f"no field {name} of metrics.json{_near(name)}")


def _near(name: str) -> str:
    names = [field.name for field in metric_fields()]
    last = name.rsplit(".", 1)[-1]
    alike = get_close_matches(last, {each.rsplit(".", 1)[-1] for each in names}, NEAR_MAX, 0.75)
    same_end = [each for each in names if each.rsplit(".", 1)[-1] in alike]
    below = [each for each in names if each.startswith(f"{name}.")]
    nearest = dict.fromkeys(chain(below, get_close_matches(name, names, NEAR_MAX), same_end))
    return f" (near: {', '.join(list(nearest)[:NEAR_MAX])})" if nearest else "; docs/metrics.md has all"


def _fields(annotation: Any, name: str) -> Iterator[MetricField]:
    """Yields the leaves of a type; a dictionary with unknown keys has one leaf."""
    kind: Any = annotation
    keys: tuple[str, ...] = (ANY_KEY,)
    between = None
    if get_origin(annotation) is Annotated:
        kind, *notes = get_args(annotation)
        keys = next((note.names for note in notes if isinstance(note, Keys)), keys)
        between = next((note for note in notes if isinstance(note, Between)), None)
    if is_typeddict(kind):
        for key, inner in get_type_hints(kind, include_extras=True).items():
            yield from _fields(inner, f"{name}.{key}" if name else key)
    elif get_origin(kind) is dict:
        for key in keys:
            yield from _fields(get_args(kind)[1], f"{name}.{key}")
    elif get_origin(kind) in (Union, UnionType):
        parts = [part for part in get_args(kind) if part is not NoneType]
        if len(parts) == 1:
            yield from _fields(parts[0], name)
        else:
            yield _leaf(name, frozenset(parts), between)
    else:
        yield _leaf(name, frozenset({get_origin(kind) or kind}), between)


def _leaf(name: str, kinds: frozenset[type], between: Between | None) -> MetricField:
    counted = bool(kinds & {int, list}) and float not in kinds
    return MetricField(name, kinds, COUNT if between is None and counted else between)
