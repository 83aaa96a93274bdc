"""Signals that give green to connections that conflict, in a scenario or a whole recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import STEP_S
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.green_conflicts import and_more, conflicting_pairs, may_give_way
from litsim_sim.scenario.signals import NAMES, Signals, SignalsFile

PERMISSIVE = (SignalState.GREEN_PERMISSIVE, SignalState.AMBER_PERMISSIVE)


@dataclass
class _Conflict:
    """Connections of two groups that conflict: those of the first pair, and the number of pairs."""

    first: str
    second: str
    pairs: int = 0


def green_conflicts(file: SignalsFile, signals: Signals, start_frame: int) -> list[str]:
    """Returns a sentence for each junction and pair of groups with green at once though their connections conflict.

    States of which some are permissive tell which group gives way: then no two whose connections conflict may be
    green. Others are plain colours, and a group has one state for all of its connections: then pairs are left out
    of which one usually gives way, see :func:`.green_conflicts.may_give_way`.
    """
    tells_who_gives_way = _tells_who_gives_way(file)
    conflicts: dict[tuple[str, int, int], _Conflict] = {}
    for i, j in conflicting_pairs(signals.links):
        own, other = signals.links[i], signals.links[j]
        first, second = sorted((int(signals.link_group[i]), int(signals.link_group[j])))
        if (tells_who_gives_way and first != second) or not may_give_way(own, other):
            conflicts.setdefault((own.junction, first, second), _Conflict(own.name, other.name)).pairs += 1
    green = signals.states == SignalState.GREEN
    return [
        _sentence(signals, junction, groups, conflict, start_frame + steps)
        for (junction, *groups), conflict in conflicts.items()
        if len(steps := np.flatnonzero(green[groups[0]] & green[groups[1]]))
    ]


def _tells_who_gives_way(file: SignalsFile) -> bool:
    """Returns whether any state of resolved signals is permissive."""
    states = {state for _, _, state in file.changes or ()}
    if file.program is not None:
        states |= {state for phase in file.program.phases for state in phase.states.values()}
    return any(NAMES[state] in PERMISSIVE for state in states)


def _sentence(signals: Signals, junction: str, groups: list[int], conflict: _Conflict, frames: np.ndarray) -> str:
    first, second = (signals.groups[group] for group in groups)
    who = f"group {first} is green" if first == second else f"groups {first} and {second} are both green"
    return (
        f"junction {junction}: {who} at {frames[0] * STEP_S:g} s, and for {len(frames) * STEP_S:g} s in all, though "
        f"{conflict.first} and {conflict.second}{and_more(conflict.pairs - 1)} conflict; are connections and times "
        f"right, or is one of them green_permissive?"
    )
