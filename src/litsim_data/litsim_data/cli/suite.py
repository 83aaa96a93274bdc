"""`data suite`: find events in recorded scenarios, and write a suite of them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from litsim_data.mining.events import Event, EventKind
from litsim_data.mining.mine import mine, possible_egos
from litsim_data.mining.selection import Chosen, Found, choose
from litsim_data.mining.suite_file import pack, scenario_names, suite_fields, write_suite
from litsim_sim.cli.program import at_least_one
from litsim_sim.core.errors import EXIT_FAILED, InputError, print_error
from litsim_sim.scenario.run_info import driver_names
from litsim_sim.scenario.scenario import Scenario

CRITICAL = 0.5  # severity at which a measure meets its criticality target
ASKED = tuple(kind for kind in EventKind if kind not in (EventKind.FOLLOWING, EventKind.TURN))
"""Kinds searched by default: all but the ubiquitous ones."""
LASTING = (EventKind.FOLLOWING, EventKind.TURN)
"""Kinds whose numbers are from anywhere between their ends, which the ends of a scenario may cut off."""


def add(subparsers: Any) -> None:
    """Add the parser of the command."""
    command = subparsers.add_parser(
        "suite",
        help="find scenarios by what happens in them: cut-ins, braking, lane changes, merges, crossings ...",
        description="Look for events around every vehicle that can be the ego, print how many there are and how "
        "severe, and write a suite for `evaluate --suite`. Equal inputs give equal suites. Each event is defined in "
        "docs/mining.md.",
    )
    names = "packaged name, scenario file, or folder that `data segments` wrote"
    command.add_argument("scenarios", nargs="+", metavar="SCENARIO", help=names)
    command.add_argument(
        "--out", type=Path, metavar="SUITE.yaml", help="suite to write; without it, only print the table"
    )
    kinds = ", ".join(EventKind)
    command.add_argument("--events", metavar="KIND[=N],...", help=f"of {kinds}; default all but following and turn")
    how = command.add_mutually_exclusive_group()
    how.add_argument("--hardest", type=at_least_one, metavar="N", help="choose the N most severe events of each kind")
    how.add_argument(
        "--spread", type=at_least_one, metavar="N", help="choose N events of each kind, spread evenly over severity"
    )
    command.add_argument("--name", help="name of the suite; default: the name of the file")
    drivers = list(driver_names())
    command.add_argument(
        "--egos", nargs="+", choices=drivers, default=["idm"], help="what drives the egos; default idm"
    )
    packed = "copy scenarios and their pieces of recordings into the folder SUITE beside the file"
    command.add_argument("--pack", action="store_true", help=packed)
    command.add_argument("--plot", type=Path, metavar="OUT.png", help="draw the severities by kind")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int | None:
    """Find, choose, print and write; return status 1 if nothing is found.

    Raises:
        InputError: a scenario cannot be used, an event is unknown, or a file cannot be written.
    """
    if arguments.pack and arguments.out is None:
        raise InputError("--pack goes with --out: scenarios are copied into a folder beside the suite")
    counts = parse_events(arguments.events)
    names = scenario_names(arguments.scenarios)
    found = find(names, list(counts))
    count = arguments.hardest or arguments.spread
    wanted = {kind: count if own is None else own for kind, own in counts.items()}
    chosen = choose(found, wanted, evenly=arguments.spread is not None)
    Console().print(table(found, chosen))
    if not found:
        print_error("no event is found" + (f": {arguments.out} is not written" if arguments.out else ""))
        return EXIT_FAILED
    if arguments.plot is not None:
        from litsim_data.mining.plots import plot_severities  # matplotlib takes half a second to load

        plot_severities(_severities(found), _severities(_why(chosen)), arguments.plot)
        print(arguments.plot)
    if arguments.out is not None:
        if arguments.pack:
            chosen = pack(chosen, arguments.out.with_suffix(""))
        fields = {"name": arguments.name or arguments.out.stem, "egos": arguments.egos}
        write_suite(arguments.out, suite_fields(chosen, arguments.out.parent, **fields))
        print(f"{arguments.out}: {len(chosen)} cases")
    return None


def find(names: Sequence[str], kinds: Sequence[EventKind]) -> list[Found]:
    """The events of `kinds` in the scenarios `names`, in order; with a progress bar on stderr.

    An event in several overlapping scenarios of one recording counts in the first.

    Raises:
        InputError: a scenario cannot be used.
    """
    found: list[Found] = []
    known, egos = _Known(), 0
    with tqdm(names, unit="scenario", dynamic_ncols=True, disable=None) as bar:  # on a terminal
        for name in bar:
            scenario = Scenario.load(name)
            egos += len(possible_egos(scenario))
            new = [event for event in mine(scenario, kinds) if not known.has(scenario, event)]
            known.add(scenario, new)
            found += [Found(name, event) for event in new]
            bar.set_postfix_str(f"{egos} egos, {len(found)} events")
    return found


class _Known:
    """The events of the scenarios that have been searched, by recording, kind and vehicles, with their frames."""

    def __init__(self) -> None:
        self._frames: dict[tuple[object, ...], list[tuple[int, int, int]]] = {}

    def has(self, scenario: Scenario, event: Event) -> bool:
        """Whether an earlier scenario has `event`: at the same frame, or a part of it that lasts into this one."""
        begin, at, end = _frames(scenario, event)
        earlier = self._frames.get(_of(scenario, event), [])
        if event.kind in LASTING:
            return any(begin <= its_end and its_begin <= end for its_begin, _, its_end in earlier)
        return any(at == its_at for _, its_at, _ in earlier)

    def add(self, scenario: Scenario, events: Sequence[Event]) -> None:
        """Add the `events` of a scenario."""
        for event in events:
            self._frames.setdefault(_of(scenario, event), []).append(_frames(scenario, event))


def _of(scenario: Scenario, event: Event) -> tuple[object, ...]:
    return scenario.file.recording, event.kind, event.ego, event.other


def _frames(scenario: Scenario, event: Event) -> tuple[int, int, int]:
    """Frames of the recording at which an event begins, has its numbers, and ends."""
    begin, at, end = (scenario.start_frame + step for step in (event.begin, event.step, event.end))
    return begin, at, end


def parse_events(text: str | None) -> dict[EventKind, int | None]:
    """The kinds that `--events` names, each with its number, if given.

    Raises:
        InputError: a kind is unknown or named twice, or its number is malformed.
    """
    if text is None:
        return dict.fromkeys(ASKED)
    counts: dict[EventKind, int | None] = {}
    for each in text.split(","):
        name, equals, number = each.strip().partition("=")
        if name not in set(EventKind):
            raise InputError(f"--events: {name!r} is no event, expected some of {', '.join(EventKind)}")
        if EventKind(name) in counts:
            raise InputError(f"--events: {name} is named twice")
        if equals and (not number.isdecimal() or int(number) < 1):
            raise InputError(f"--events: {each.strip()!r}, expected a whole number of at least 1 after {name}=")
        counts[EventKind(name)] = int(number) if equals else None
    return counts


def table(found: Sequence[Found], chosen: Sequence[Chosen]) -> Table:
    """Table of the events by kind: their number, egos, severities, and the number of cases chosen."""
    columns = ("event", "found", "egos", "least", "25 %", "median", "75 %", "most", f"from {CRITICAL:g} on", "cases")
    out = Table(title=f"severity of {len(found)} events", title_justify="left", box=None, pad_edge=False)
    for number, column in enumerate(columns):
        out.add_column(column, justify="right" if number else "left")
    taken = _severities(_why(chosen))
    for kind, values in _severities(found).items():
        seats = {each.seat for each in found if each.event.kind == kind}
        quantiles = [f"{value:.2f}" for value in np.quantile(values, [0.0, 0.25, 0.5, 0.75, 1.0])]
        critical = sum(value >= CRITICAL for value in values)
        counts = (len(values), len(seats)), (critical, len(taken.get(kind, ())))
        out.add_row(kind.replace("_", " "), *map(str, counts[0]), *quantiles, *map(str, counts[1]))
    out.add_section()
    out.add_row("all", str(len(found)), str(len({each.seat for each in found})), *[""] * 6, str(len(chosen)))
    return out


def _why(chosen: Sequence[Chosen]) -> list[Found]:
    """The events for which cases were chosen."""
    return [Found(each.scenario, event) for each in chosen for event in each.events[: len(each.kinds)]]


def _severities(found: Sequence[Found]) -> dict[EventKind, list[float]]:
    """Severities by kind, in the order of kinds."""
    by_kind = {kind: [each.event.severity for each in found if each.event.kind == kind] for kind in EventKind}
    return {kind: values for kind, values in by_kind.items() if values}
