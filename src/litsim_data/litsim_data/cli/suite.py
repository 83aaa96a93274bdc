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

from litsim_data.mining.events import EventKind
from litsim_data.mining.mine import mine, possible_egos
from litsim_data.mining.selection import Chosen, MinedEvent, choose
from litsim_data.mining.suite_file import pack, scenario_names, write_suite
from litsim_sim.cli.program import at_least_one
from litsim_sim.core.errors import EXIT_FAILED, InputError, print_error
from litsim_sim.scenario.run_info import driver_names
from litsim_sim.scenario.scenario import Scenario

CRITICAL = 0.5  # severity at which a measure meets its criticality target
SEARCHED = tuple(kind for kind in EventKind if kind not in (EventKind.FOLLOWING, EventKind.TURN))
"""Kinds searched by default: all but the ubiquitous ones."""
LASTING = (EventKind.FOLLOWING, EventKind.TURN)
"""Kinds whose numbers are from anywhere between their ends, which the ends of a scenario may cut off."""


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
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
    command.add_argument("--ego", nargs="+", choices=drivers, default=["idm"], help="what drives the ego; default idm")
    packed = "copy scenarios and their pieces of recordings into the folder SUITE beside the file"
    command.add_argument("--pack", action="store_true", help=packed)
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int | None:
    """Finds, chooses, prints and writes; returns status 1 if nothing is found.

    Raises:
        InputError: a scenario cannot be used, an event is unknown, or a file cannot be written.
    """
    if arguments.pack and arguments.out is None:
        raise InputError("--pack goes with --out: scenarios are copied into a folder beside the suite")
    counts = parse_events(arguments.events)
    events = find(scenario_names(arguments.scenarios), list(counts))
    count = arguments.hardest or arguments.spread
    wanted = {kind: own or count for kind, own in counts.items()}
    chosen = choose(events, wanted, evenly=arguments.spread is not None)
    reasons = [MinedEvent(case.scenario, event) for case in chosen for event in case.events[: len(case.kinds)]]
    Console().print(_table(events, chosen, _severities(events), _severities(reasons)))
    if not events:
        print_error("no event is found" + (f": {arguments.out} is not written" if arguments.out else ""))
        return EXIT_FAILED
    if arguments.out is not None:
        if arguments.pack:
            chosen = pack(chosen, arguments.out.with_suffix(""))
        write_suite(arguments.out, chosen, arguments.name or arguments.out.stem, arguments.ego)
        print(f"{arguments.out}: {len(chosen)} cases")
    return None


def find(names: Sequence[str], kinds: Sequence[EventKind]) -> list[MinedEvent]:
    """Returns the events of `kinds` in the scenarios `names`, in order, with a progress bar on a terminal.

    An event in several overlapping scenarios of one recording counts in the first: one at the same frame, or of a kind
    of LASTING a part of it that lasts into the next scenario.

    Raises:
        InputError: a scenario cannot be used.
    """
    events: list[MinedEvent] = []
    frames_of: dict[tuple[object, ...], list[tuple[int, int, int]]] = {}  # frames of begin, numbers and end
    egos = 0
    with tqdm(names, unit="scenario", dynamic_ncols=True, disable=None) as bar:
        for name in bar:
            scenario = Scenario.load(name)
            egos += len(possible_egos(scenario))
            of_scenario = []
            for event in mine(scenario, kinds):
                key = (scenario.file.recording, event.kind, event.ego, event.other)
                begin, instant, end = (scenario.start_frame + step for step in (event.begin, event.step, event.end))
                lasting = event.kind in LASTING
                if not any(
                    begin <= its_end and its_begin <= end if lasting else instant == its_at
                    for its_begin, its_at, its_end in frames_of.get(key, [])
                ):
                    events.append(MinedEvent(name, event))
                    of_scenario.append((key, (begin, instant, end)))
            for key, frames in of_scenario:
                frames_of.setdefault(key, []).append(frames)
            bar.set_postfix_str(f"{egos} egos, {len(events)} events")
    return events


def parse_events(text: str | None) -> dict[EventKind, int | None]:
    """Returns the kinds that `--events` names, each with its number, if given.

    Raises:
        InputError: a kind is unknown or named twice, or its number is malformed.
    """
    if text is None:
        return dict.fromkeys(SEARCHED)
    counts: dict[EventKind, int | None] = {}
    for part in text.split(","):
        name, equals, number = part.strip().partition("=")
        if name not in set(EventKind):
            raise InputError(f"--events: {name!r} is no event, expected some of {', '.join(EventKind)}")
        if EventKind(name) in counts:
            raise InputError(f"--events: {name} is named twice")
        if equals and (not number.isdecimal() or int(number) < 1):
            raise InputError(f"--events: {part.strip()!r}, expected a whole number of at least 1 after {name}=")
        counts[EventKind(name)] = int(number) if equals else None
    return counts


def _table(
    events: Sequence[MinedEvent],
    chosen: Sequence[Chosen],
    severities: dict[EventKind, list[float]],
    taken: dict[EventKind, list[float]],
) -> Table:
    """Returns a table of the events by kind: their number, egos, severities, and the number of cases chosen."""
    columns = ("event", "found", "egos", "least", "25 %", "median", "75 %", "most", f"from {CRITICAL:g} on", "cases")
    table = Table(title=f"severity of {len(events)} events", title_justify="left", box=None, pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left")
    for kind, values in severities.items():
        egos = len({seated.seat for seated in events if seated.event.kind == kind})
        quantiles = [f"{value:.2f}" for value in np.quantile(values, [0.0, 0.25, 0.5, 0.75, 1.0])]
        critical, cases = sum(value >= CRITICAL for value in values), len(taken.get(kind, ()))
        table.add_row(kind.replace("_", " "), str(len(values)), str(egos), *quantiles, str(critical), str(cases))
    table.add_section()
    table.add_row("all", str(len(events)), str(len({seated.seat for seated in events})), *[""] * 6, str(len(chosen)))
    return table


def _severities(events: Sequence[MinedEvent]) -> dict[EventKind, list[float]]:
    """Returns the severities by kind, in the order of kinds."""
    by_kind = {kind: [seated.event.severity for seated in events if seated.event.kind == kind] for kind in EventKind}
    return {kind: values for kind, values in by_kind.items() if values}
