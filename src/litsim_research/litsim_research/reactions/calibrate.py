"""`train followers`: the car following of policy litsim, fitted to recorded followers in LITSIM_DATA.

Followers of the tuning part are driven anew for 6 s behind their recorded leaders, from every other second of their
tracks. What counts is the error of their positions over 5 s, tenfold where the leader is about to brake, so that both
kinds of moments weigh about as much. In the table, each driver is fitted to one half of the followers and judged by the
other, both ways. The values below are fitted to all of them: the defaults of policy.follower, rounded. No follower of
the reported part is read.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize
from tqdm import tqdm

from litsim_data.encounters.following import following_tracks
from litsim_policy.driving.follower import FollowerConfig
from litsim_policy.driving.handback import COMFORTABLE
from litsim_policy.motion.car_following import IdmConfig, IdmValues
from litsim_research.reactions.starts import Starts, driven, headway_spread, headways_of, strongest_braking
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.scenario.scenario import DATA_VARIABLE

JUDGED = 50  # [steps] of which positions count
BRAKING_WEIGHT = 10.0  # of moments in which the leader is about to brake
HARDEST = 0.99  # share of moments with braking leaders in which people brake no harder than `braking_max`
BRAKING_MAX = FollowerConfig().braking_max
BEGIN = (1.0, 2.0, 1.0, 1.5, 5.0)  # of the search, in the order of Candidate
REACH = 0.3  # of the first steps of the search, in logarithms
EVALUATIONS = 400  # of the search, at most; it ends before


class Candidate(NamedTuple):
    """Parameters of a driver: those of :class:`FollowerConfig` that are fitted; infinite looks for one headway."""

    headway: float
    standstill_gap: float
    acceleration: float
    deceleration: float
    looks: float

    @property
    def model(self) -> IdmValues:
        """The parameters of the car following."""
        return IdmValues(*self[:4], BRAKING_MAX)

    def drive(self, starts: Starts) -> tuple[FloatArray, FloatArray]:
        """Returns fronts [m] and speeds [m/s] of the followers of `starts`, as :func:`driven`."""
        looks_back = np.isfinite(self.looks)
        headway = headways_of(starts, self.model, self.looks) if looks_back else np.full(len(starts), self.headway)
        return driven(starts, headway, self.model)


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research train followers``."""
    return Parser(prog="train followers", description=__doc__)


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_research train followers``."""
    parser().parse_args(argv)
    data = os.environ.get(DATA_VARIABLE)
    if not data:
        raise InputError(f"train followers: needs recorded car following: set {DATA_VARIABLE} to the folder of ngsim/")
    starts = Starts.of(track for track in following_tracks(Path(data).expanduser()) if track.split == "tuning")
    drivers = len(np.unique(starts.driver))
    print(f"{len(starts)} starts of {drivers} drivers, {starts.brakes.sum()} with braking leaders")
    table = Table("driver", title="6 s behind braking leaders")
    for column in ("error, m", "else, m", "braking, m/s²", "least gap, m", "TTC < 2 s"):
        table.add_column(column, justify="right")
    table.add_row("people", "", "", *figures(starts, starts.front, starts.speed))
    with tqdm(CANDIDATES.items(), unit="driver", dynamic_ncols=True) as bar:
        for name, fitted in bar:
            table.add_row(name, *judged(starts, fitted))
    Console().print(table)
    hardest = np.quantile(strongest_braking(starts.front[starts.brakes]), HARDEST)
    print(f"people brake by at most {hardest:.2f} m/s2 in {HARDEST:.0%} of these moments")
    for name, fitted in list(CANDIDATES.items())[-2:]:
        chosen = fitted(starts)
        print(f"{name}:", ", ".join(f"{field} {value:.3g}" for field, value in chosen._asdict().items()))
    print(f"spread of headways around those known: {headway_spread(starts, chosen.model, chosen.looks):.3g}")


def judged(starts: Starts, fitted: Callable[[Starts], Candidate]) -> tuple[str, ...]:
    """Returns the errors and :func:`figures` of drivers that are fitted to one half of the drivers, on the other."""
    half_of = np.random.default_rng(0).permutation(int(starts.driver.max()) + 1) % 2
    first = half_of[starts.driver] == 0
    front, speed = np.empty(starts.front.shape), np.empty(starts.front.shape)
    for half in (first, ~first):
        front[half], speed[half] = fitted(starts.take(~half)).drive(starts.take(half))
    error = errors(starts, front)
    both = error[starts.brakes].mean(), error[~starts.brakes].mean()
    return (*(f"{mean:.3f}" for mean in both), *figures(starts, front, speed))


def fit(starts: Starts, *, own_headway: bool) -> Candidate:
    """Returns the driver with the least error on `starts`, with or without a headway of each driver's own."""
    weight = np.where(starts.brakes, BRAKING_WEIGHT, 1.0)
    begin = np.log(BEGIN if own_headway else BEGIN[:-1])

    def candidate(logarithms: FloatArray) -> Candidate:
        return Candidate(*np.exp(logarithms).tolist(), *([] if own_headway else [np.inf]))

    def loss(logarithms: FloatArray) -> float:
        return float(np.average(errors(starts, candidate(logarithms).drive(starts)[0]), weights=weight))

    simplex = begin + REACH * np.eye(len(begin) + 1, len(begin), -1)
    options = {"maxfev": EVALUATIONS, "xatol": 1e-3, "fatol": 1e-5, "initial_simplex": simplex}
    return candidate(minimize(loss, begin, method="Nelder-Mead", options=options).x)


def fixed(config: IdmConfig, starts: Starts) -> Candidate:  # noqa: ARG001 - as those that are fitted
    """Returns the driver of `config`, whatever the `starts`."""
    return Candidate(*config.values[:4], np.inf)


CANDIDATES: dict[str, Callable[[Starts], Candidate]] = {
    "published": partial(fixed, IdmConfig()),
    "hand-backs": partial(fixed, COMFORTABLE),
    "one headway": partial(fit, own_headway=False),
    "own headway": partial(fit, own_headway=True),
}
"""Drivers by name, as functions of the starts to fit them to."""


def errors(starts: Starts, front: FloatArray) -> FloatArray:
    """Returns mean errors (n,) [m] of the positions `front` (n, STEPS + 1) [m] over 5 s."""
    return np.asarray(np.abs(front - starts.front)[:, 1 : JUDGED + 1].mean(axis=1))


def figures(starts: Starts, front: FloatArray, speed: FloatArray) -> tuple[str, str, str]:
    """Returns medians of strongest braking and least gap, and the share of low times to collision, behind who brakes.

    `front` [m] and `speed` [m/s] are (n, STEPS + 1).
    """
    gap, closing = (starts.leader_rear - front)[starts.brakes], (speed - starts.leader_speed)[starts.brakes]
    close = ((closing > 0.0) & (gap < 2.0 * closing)).any(axis=1)
    braking = strongest_braking(front[starts.brakes])
    return f"{np.median(braking):.2f}", f"{np.median(gap.min(axis=1)):.1f}", f"{close.mean():.1%}"
