"""Comfort: how often an agent stays within nuPlan's bounds, and how often it brakes hard."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from litsim_data.mining.lane_tracks import true_runs
from litsim_eval.analysis.measure import (
    HIGHER,
    LOWER,
    SUM_CONTROLLED,
    Count,
    Measure,
    Metrics,
    Row,
    Share,
    Span,
    Table,
    family,
    figure_at,
    in_percent,
    mean,
    percent,
    share_of,
)
from litsim_eval.analysis.measures.collision import collisions
from litsim_sim.core.scene import AgentTable, BoolArray, Controller, ControlSource, FloatArray, IntArray
from litsim_sim.core.steps import Steps
from litsim_sim.record.run import Run

BOUNDS: dict[str, tuple[float, float]] = {
    "longitudinal_acceleration": (-4.05, 2.40),  # [m/s2]
    "lateral_acceleration": (-4.89, 4.89),  # [m/s2]
    "yaw_rate": (-0.95, 0.95),  # [rad/s]
    "yaw_acceleration": (-1.93, 1.93),  # [rad/s2]
    "longitudinal_jerk": (-4.13, 4.13),  # [m/s3]
    "jerk": (0.0, 8.37),  # [m/s3], magnitude
}
"""nuPlan's bounds of a comfortable ride (Caesar et al. 2021)."""

MOTIONS = {
    "longitudinal_acceleration": ("accelerating and braking", "m/s²"),
    "lateral_acceleration": ("acceleration to the side", "m/s²"),
    "yaw_rate": ("yaw rate", "rad/s"),
    "yaw_acceleration": ("yaw acceleration", "rad/s²"),
    "longitudinal_jerk": ("jerk along the way", "m/s³"),
    "jerk": ("jerk", "m/s³"),
}
"""Name and unit of each of :data:`BOUNDS`."""

HARD_BRAKE = -3.0  # [m/s2]
BRAKE_OVER = -1.0  # [m/s2] above which a hard brake is over; braking hard again before that continues it
ROUNDING = 1e-6  # [m/s2] tolerance on HARD_BRAKE: a command of exactly that deceleration is not a hard brake


@dataclass(frozen=True)
class Comfort:
    """Comfort of one agent's motion.

    Attributes:
        within: share of steps within each of :data:`BOUNDS`.
        hard_brakes: number of manoeuvres that brake harder than 3 m/s2.
        hard_brakes_driven: how many of them begin to do so off the log, driven by a policy or a stack.
    """

    within: dict[str, float]
    hard_brakes: int
    hard_brakes_driven: int

    @property
    def comfortable(self) -> bool:
        """Whether every step keeps every bound."""
        return all(share == 1.0 for share in self.within.values())


def comfort(tables: Sequence[AgentTable], agent: int, dt: float) -> Comfort | None:
    """Returns the comfort of `agent` over `tables`, steps of `dt` [s].

    None where it is on the road for fewer than three steps, or for no two in a row.
    """
    steps = Steps.of(tables)
    rows, table = steps.track(agent), steps.stacked
    follows = np.diff(steps.step[table.number[rows]]) == 1
    if len(rows) < 3 or not follows.any():
        return None
    speed, acceleration, yaw_rate, controller = (
        getattr(table, field)[rows] for field in ("speed", "acceleration", "yaw_rate", "controller")
    )
    values = motion_values(speed, acceleration, yaw_rate, dt)
    within = {}
    for name, (low, high) in BOUNDS.items():
        defined = values[name] if len(values[name]) == len(rows) else values[name][follows]
        within[name] = float(np.mean((defined >= low) & (defined <= high)))
    begins = hard_brakes_begin(acceleration)
    return Comfort(within, int(begins.sum()), int((begins & (controller != Controller.LOG)).sum()))


def hard_brakes_begin(acceleration: FloatArray) -> BoolArray:
    """Returns (n,) whether a brake beyond 3 m/s2 begins at each of consecutive steps with `acceleration` (n,) [m/s2].

    It is over once the deceleration is below 1 m/s2, so that a deceleration around 3 m/s2 counts once.
    """
    hard, over = acceleration < HARD_BRAKE - ROUNDING, acceleration > BRAKE_OVER
    begins, braking = np.zeros(len(acceleration), np.bool_), False
    for k in np.flatnonzero(hard | over).tolist():
        begins[k] = hard[k] and not braking
        braking = bool(hard[k])
    return begins


def hard_brakes_in_log(tables: Sequence[AgentTable], log: Sequence[AgentTable], agent: int) -> int:
    """Returns the number of hard brakes in the log of `agent` that begin while the run has it off its log."""
    steps, logged = Steps.of(tables), Steps.of(log)
    rows = steps.track(agent)
    driven = steps.stacked.number[rows[steps.stacked.controller[rows] != Controller.LOG]]
    then = logged.track(agent)
    begins = logged.stacked.number[then[hard_brakes_begin(logged.stacked.acceleration[then])]]
    return int(np.isin(logged.step[begins], steps.step[driven]).sum())


def motion_values(
    speed: FloatArray, acceleration: FloatArray, yaw_rate: FloatArray, dt: float
) -> dict[str, FloatArray]:
    """Returns the quantities of BOUNDS from speed [m/s], acceleration [m/s2] and yaw rate [rad/s], each (n,).

    Derivatives are differences over a step, so they have n - 1 values.
    """
    lateral = speed * yaw_rate
    jerk_along, jerk_across = np.diff(acceleration) / dt, np.diff(lateral) / dt
    return {
        "longitudinal_acceleration": acceleration,
        "lateral_acceleration": lateral,
        "yaw_rate": yaw_rate,
        "yaw_acceleration": np.diff(yaw_rate) / dt,
        "longitudinal_jerk": jerk_along,
        "jerk": np.hypot(jerk_along, jerk_across),
    }


def spans(step: IntArray, is_missed: BoolArray) -> list[Span]:
    """Returns first and last of successive steps (n,) at which something is missed (n,)."""
    return [(int(step[begin]), int(step[end - 1])) for begin, end in true_runs(is_missed)]


def comfort_of_ego(run: Run) -> Comfort | None:
    """Returns the comfort of the ego after the history."""
    return comfort(run.simulated.only([run.info.ego_id]), run.info.ego_id, run.info.dt)


class Felt(NamedTuple):
    """Comfort of the agents ever under control, and the number of hard brakes of their logs meanwhile."""

    agents: list[Comfort]
    brakes_in_log: int


def felt_by_controlled(run: Run) -> Felt:
    """Returns the comfort of the agents ever under control."""
    agents, brakes_in_log = [], 0
    for group, own in run.simulated.groups(run.once(collisions).controlled):
        log = run.simulated_log.only(group)
        agents += [felt for agent in group if (felt := comfort(own, agent, run.info.dt)) is not None]
        brakes_in_log += sum(hard_brakes_in_log(own, log, agent) for agent in group)
    return Felt(agents, brakes_in_log)


def commands_of_policy(run: Run) -> Counter[int]:
    """Returns the number of the policy's commands that were applied, by source.

    Applied are the answers to all steps after the history but the last. Hand-backs and baselines have no guard.
    """
    last, counts = run.tables[-1].step, Counter[int]()
    for step in run.controls:
        if run.info.history_steps <= step < last:
            counts.update(run.controls[step].source.tolist())
    return Counter({source: counts[source] for source in (ControlSource.GUARDED, ControlSource.POLICY)})


def _comfortable(run: Run) -> float | None:
    agents = run.once(felt_by_controlled).agents
    return share_of(sum(agent.comfortable for agent in agents), len(agents))


def _guarded_share(run: Run) -> float | None:
    commands = run.once(commands_of_policy)
    return share_of(commands[ControlSource.GUARDED], commands.total())


def _of_ego(read: Callable[[Comfort], float]) -> Callable[[Run], float | None]:
    """Returns the function of a figure of the ego's comfort; None without any."""

    def value(run: Run) -> float | None:
        felt = run.once(comfort_of_ego)
        return None if felt is None else read(felt)

    return value


def _beyond(name: str, value: float, limit: str, _: Metrics) -> str:
    """Returns a sentence on the share of steps within one of :data:`BOUNDS`."""
    (what, unit), (low, high) = MOTIONS[name], BOUNDS[name]
    return f"{what} within {low:g} to {high:g} {unit} at {percent(value)} of the steps, expected {in_percent(limit)}"


def _moments_beyond(name: str, run: Run, _: Metrics) -> list[Span]:
    """Returns the steps at which the ego is not within one of :data:`BOUNDS`."""
    rows, table = run.simulated.track(run.info.ego_id), run.simulated.stacked
    step, (low, high) = run.simulated.step[table.number[rows]], BOUNDS[name]
    value = motion_values(table.speed[rows], table.acceleration[rows], table.yaw_rate[rows], run.info.dt)[name]
    return spans(step[len(step) - len(value) :], (value < low) | (value > high))


def _within(name: str) -> Measure:
    """Returns the measure of one of :data:`BOUNDS`."""
    return Share(
        f"comfort.ego.within.{name}",
        _of_ego(lambda felt: felt.within[name]),
        f"ego: comfort of {MOTIONS[name][0]}",
        better=HIGHER,
        sentence=partial(_beyond, name),
        moments=partial(_moments_beyond, name),
    )


def _least_kept(run: Metrics) -> float | None:
    """Returns the share of the ego's bound of comfort that is least kept."""
    ego = run.get("comfort", {}).get("ego") or {}
    return min((share for share in ego.get("within", {}).values() if share is not None), default=None)


KEPT = (Row("ego_comfort", mean, Table.EGO, "ego: steps in comfort", figure=_least_kept, share=True, better=HIGHER),)
IN_LOG = (Row(title="of the log meanwhile", of_control=True),)
GUARDED, COMMANDS = "comfort.controlled.guarded.count", "comfort.controlled.guarded.commands"
GUARDED_SHARE = (Row("guarded", figure=figure_at(GUARDED), below=figure_at(COMMANDS), share=True, of_control=True),)
MEASURES = family(
    "share of steps within each of nuPlan's bounds",
    *map(_within, BOUNDS),
    "[hard brakes](#hard-brakes) of the ego",
    Count("comfort.ego.hard_brakes", _of_ego(lambda felt: felt.hard_brakes), "ego: hard brakes", "", LOWER, rows=KEPT),
    "share of the agents ever under control that keep every bound at every step, on their logs too",
    Share("comfort.controlled.comfortable", _comfortable, "controlled: always in comfort", "", HIGHER),
    "[hard brakes](#hard-brakes) begun under control; of the logs of the same agents at the same steps",
    Count(
        "comfort.controlled.hard_brakes",
        lambda run: sum(agent.hard_brakes_driven for agent in run.once(felt_by_controlled).agents),
        *("hard brakes under control", "", LOWER),
        rows=SUM_CONTROLLED,
    ),
    Count("comfort.controlled.hard_brakes_log", lambda run: run.once(felt_by_controlled).brakes_in_log, rows=IN_LOG),
    "agent-steps at which the [guard](training.md#what-drives-an-agent) of policy C changed the command; all at which "
    "the policy drives, hand-backs excluded; and their share",
    Count(GUARDED, lambda run: run.once(commands_of_policy)[ControlSource.GUARDED]),
    Count(COMMANDS, lambda run: run.once(commands_of_policy).total()),
    Share("comfort.controlled.guarded.share", _guarded_share, "guarded steps of policy C", rows=GUARDED_SHARE),
)
