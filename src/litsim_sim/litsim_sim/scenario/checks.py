"""Whether what a scenario file names fits together: its egos with the recording, the net with both."""

from __future__ import annotations

from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.maps.lane_map import LaneMap
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario_file import ScenarioFile

COVERAGE_MIN = 0.9  # share of recorded box centres that must lie on the road


def check_agents(file: ScenarioFile, log: Log, history_steps: int, where: str) -> None:
    """Check that every ego that `file` names is there from step 0 through the first simulated step.

    Raises:
        InputError: one is not, or is both for tuning and for experiments; `where` names the scenario.
    """
    both = sorted(set(file.egos) & set(file.tuning))
    if both:
        raise InputError(f"{where}: field tuning repeats {both} of field egos, expected disjoint lists")
    needed = history_steps + 1
    for field, agents in (("ego", [file.ego]), ("egos", file.egos), ("tuning", file.tuning)):
        for agent in agents:
            row = log.row(agent)
            if row < 0:
                start = ", ".join(str(i) for i in log.ids[log.valid[:, 0]])
                raise InputError(f"{where}: field {field}: no vehicle {agent}; present at the start: {start}")
            first, last = int(log.first_step[row]), int(log.last_step[row])
            if first > 0 or last < needed:
                raise InputError(
                    f"{where}: field {field}: vehicle {agent} is present in steps {first} to {last}, expected at "
                    f"least steps 0 to {needed} (the history and the first simulated step)"
                )


def check_coverage(lane_map: LaneMap, net: Path, log: Log, where: str) -> None:
    """Check that the net lies under the recording.

    Raises:
        InputError: too many box centres are on no lane; `where` names the scenario.
    """
    x, y = log.x[log.valid], log.y[log.valid]
    share = float(lane_map.inside_road(x, y).mean())
    if share < COVERAGE_MIN:
        x0, y0, x1, y1 = lane_map.bounds
        raise InputError(
            f"{where}: net {net.name} does not cover the recording: {share:.1%} of the box centres are "
            f"on its lanes, expected {COVERAGE_MIN:.0%}; the recording spans x {x.min():.0f} to {x.max():.0f}, "
            f"y {y.min():.0f} to {y.max():.0f} m, the net x {x0:.0f} to {x1:.0f}, y {y0:.0f} to {y1:.0f} m"
        )
