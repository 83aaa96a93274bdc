"""Connections that conflict and have green together: pairs of foes, and those in the signal programs of a net."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from litsim_sim.core.signals import OF_SUMO, SignalState
from litsim_sim.lane_map.net_lanes import UNREADABLE, parse_net, unreadable_net
from litsim_sim.lane_map.signal_links import SignalLink, read_links

CROSSING = np.sin(np.deg2rad(45.0))  # of the angle between two approaches, above which they cross each other


def conflicting_pairs(links: Sequence[SignalLink]) -> list[tuple[int, int]]:
    """Returns the positions in `links` of the pairs of connections that conflict, see :attr:`.SignalLink.foes`."""
    place = {link.name: k for k, link in enumerate(links)}
    both = ((place[foe], k) for k, link in enumerate(links) for foe in link.foes if foe in place)
    return sorted({(min(pair), max(pair)) for pair in both})


def may_give_way(own: SignalLink, other: SignalLink) -> bool:
    """Returns whether one of two connections that conflict usually gives way when both have a plain green light.

    That is so where one turns and both come from the same or from opposite directions, as left turns do before oncoming
    traffic.
    """
    return bool((own.turns or other.turns) and abs(np.sin(own.heading - other.heading)) <= CROSSING)


def and_more(number: int) -> str:
    """Returns a text on `number` further pairs, empty for none."""
    return f" (and {number} more pair{'s' * (number > 1)})" if number else ""


def program_conflicts(net: Path) -> tuple[str, ...]:
    """Returns a sentence for each phase of a program in which connections that conflict both have priority (G)."""
    links = read_links(net)
    pairs = [(links[i], links[j]) for i, j in conflicting_pairs(links) if links[i].light == links[j].light]
    if not pairs:
        return ()
    try:
        lights = parse_net(net, programs=True).getTrafficLights()
        programs = {light.getID(): light.getPrograms() for light in lights}
    except UNREADABLE as error:
        raise unreadable_net(net, error) from error
    return tuple(
        sentence
        for junction, light in dict.fromkeys((link.junction, link.light) for link, _ in pairs)
        for name, program in programs.get(light, {}).items()
        for sentence in _phases(
            f"junction {junction}: program {name} of light {light}",
            program.getPhases(),
            [pair for pair in pairs if (pair[0].junction, pair[0].light) == (junction, light)],
        )
    )


def _phases(what: str, phases: Sequence[Any], pairs: Sequence[tuple[SignalLink, SignalLink]]) -> Iterator[str]:
    """Yields a sentence for each of `phases` in which both connections of some of `pairs` have priority green."""
    end = 0.0
    for number, phase in enumerate(phases):
        begin, end = end, end + phase.duration
        both = [(a, b) for a, b in pairs if _is_green(phase.state, a) and _is_green(phase.state, b)]
        if both:
            own, other = both[0]
            yield (
                f"{what} has G for {own.name} and {other.name}{and_more(len(both) - 1)}, which conflict, in phase "
                f"{number}, {begin:g} to {end:g} s into the cycle; expected g for those that give way"
            )


def _is_green(state: str, link: SignalLink) -> bool:
    return link.index < len(state) and OF_SUMO.get(state[link.index]) == SignalState.GREEN
