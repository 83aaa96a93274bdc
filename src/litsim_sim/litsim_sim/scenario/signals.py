"""The signals of a scenario: the connections of each signal group, and its state at each step.

docs/signals.md has an example of every kind.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from litsim_sim.core.errors import InputError
from litsim_sim.core.quantities import OneOf
from litsim_sim.core.scene import RATE_HZ, STEP_S, ByteArray, IntArray
from litsim_sim.core.signals import STOP_STATES, SignalState, SignalTable
from litsim_sim.io.input_files import require_file
from litsim_sim.io.table_input import TableFile, is_stamped, seconds_of
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.lane_map.signal_links import ARROW, SignalLink, crossings, read_links
from litsim_sim.scenario.log import Log

if TYPE_CHECKING:
    import pandas as pd

NAMES = {state.name.lower(): state for state in SignalState} | {
    "yellow": SignalState.AMBER,
    "red_yellow": SignalState.RED_AMBER,
    "flashing_yellow": SignalState.FLASHING_AMBER,
    "off": SignalState.DARK,
    "unknown": SignalState.UNAVAILABLE,
}
StateName = Annotated[str, OneOf(tuple(NAMES)), BeforeValidator(lambda name: "off" if name is False else name)]
"""Name of a state; to YAML, off without quotes is a truth value."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "frame": STEP_S}
AT_RED_MAX, PASSED_MIN = 0.5, 5  # a group is refused above this share of passages at red, of at least so many passages


def _ids_as_text(value: Any) -> Any:
    """Convert integers to text, also in lists and keys: ids of files and maps are names here."""
    if isinstance(value, dict):
        return {_ids_as_text(key): content for key, content in value.items()}
    if isinstance(value, list):
        return [_ids_as_text(item) for item in value]
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


_Named = BeforeValidator(_ids_as_text)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class StateList(_Strict):
    """A file (CSV or Parquet) with one row per change, of one group or of all.

    Attributes:
        file: path relative to the file that names it.
        group: its column of groups; or the columns that hold the states of a group each, and are named after it.
        begin, state: its columns of times and of states; the latter is not used if groups have columns of their own.
        unit: unit of `begin`, which counts from frame 0 of the recording; not used for dates with times.
        codes: our names of states, by those of the file, if they differ.
    """

    file: Annotated[str, Field(min_length=1)]
    group: str | Annotated[list[str], Field(min_length=1)] = "group"
    begin: str = "begin"
    state: str = "state"
    unit: Literal["s", "ms", "us", "ns", "frame"] = "s"
    codes: Annotated[dict[str, StateName], _Named] = {}


class Phase(_Strict):
    """A phase of a fixed cycle; groups that are not named show red."""

    duration_s: Annotated[float, Field(ge=STEP_S, le=86_400.0, allow_inf_nan=False)]
    states: Annotated[dict[str, StateName], _Named] = {}


class Program(_Strict):
    """A fixed cycle of phases, as in timing plans.

    Attributes:
        offset_s: start of the first phase, from frame 0 of the recording [s].
        phases: phases in order.
    """

    offset_s: Finite = 0.0
    phases: Annotated[list[Phase], Field(min_length=1)]


class SignalsFile(_Strict):
    """A file of signals: groups, and their states in one of three forms.

    Attributes:
        groups: connections of each group by its name: ``FROM_LANE -> TO_LANE``, or ``FROM_LANE`` for all of a lane, or
            ``EDGE`` for all of its lanes; empty for a group of the recording that is not needed.
        changes: [seconds from frame 0 of the recording, group, state], ascending for each group.
        states: a file of changes.
        program: a fixed cycle.
    """

    groups: Annotated[dict[str, Annotated[list[str], _Named]], Field(min_length=1), _Named]
    changes: list[tuple[Finite, str, StateName]] | None = None
    states: StateList | None = None
    program: Program | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        sources = [name for name in ("changes", "states", "program") if getattr(self, name) is not None]
        if len(sources) != 1:
            raise ValueError(f"expected one of changes, states and program, found {' and '.join(sources) or 'none'}")
        return self

    @model_validator(mode="after")
    def _changes_follow_each_other(self) -> Self:
        last: dict[str, tuple[float, str]] = {}
        for begin, group, state in self.changes or []:
            if group not in self.groups:
                raise ValueError(f"changes: group {group} is not among groups, {', '.join(sorted(self.groups))}")
            before, other = last.get(group, (-np.inf, state))
            if begin < before:
                raise ValueError(f"changes: group {group}: {begin:g} s after {before:g} s, not ascending")
            if begin == before and NAMES[state] != NAMES[other]:
                raise ValueError(f"changes: group {group} shows {other} and {state} at {begin:g} s, expected one")
            last[group] = begin, state
        return self


@dataclass(frozen=True)
class Signals:
    """States of all signal groups at every step of a scenario.

    Attributes:
        groups: names of the g groups, sorted.
        links: controlled connections, sorted by name.
        link_group: (links,) index of the group that controls each connection.
        states: (g, steps) :class:`SignalState`.
    """

    groups: tuple[str, ...]
    links: tuple[SignalLink, ...]
    link_group: IntArray
    states: ByteArray

    def table(self, step: int) -> SignalTable:
        """Returns the states of the groups at `step`; beyond the last step, those of the last."""
        return SignalTable(step, self.groups, self.states[:, min(step, self.states.shape[1] - 1)])

    def of_links(self, step: int) -> ByteArray:
        """Returns the :class:`SignalState` (scenes, links) at `step`; beyond the last step, those of the last."""
        return self.states[None, self.link_group, min(step, self.states.shape[1] - 1)]

    @property
    def known(self) -> bool:
        """Whether the state of any group is known at any step."""
        return bool((self.states != SignalState.UNAVAILABLE).any())

    @cached_property
    def link_names(self) -> tuple[str, ...]:
        """Names of the connections, in the order of `links`."""
        return tuple(link.name for link in self.links)


@dataclass(frozen=True)
class BatchedSignals:
    """The signals of several scenes on one net.

    Attributes:
        links: controlled connections of the net, which all scenes share.
        states: (scenes, links, steps of the longest) :class:`SignalState`.
    """

    links: tuple[SignalLink, ...]
    states: ByteArray

    @classmethod
    def of(cls, signals: Sequence[Signals]) -> BatchedSignals:
        """Join the `signals` of the scenes, one at least; beyond the last step of one, its states are those of that."""
        of_links = [of_one.states[of_one.link_group] for of_one in signals]
        steps = max(states.shape[1] for states in of_links)
        padded = [np.pad(states, ((0, 0), (0, steps - states.shape[1])), "edge") for states in of_links]
        return cls(signals[0].links, np.stack(padded))

    def of_links(self, step: int) -> ByteArray:
        """See :meth:`Signals.of_links`."""
        return self.states[:, :, min(step, self.states.shape[2] - 1)]


LinkSignals = Signals | BatchedSignals
"""The signals of one scene, or of several that are stepped together: `links`, and their states by `of_links`."""


def read_signals(path: Path) -> SignalsFile:
    """Read a file of signals, with the file of changes that it refers to.

    Raises:
        InputError: it cannot be read, a field does not fit, or a file of changes cannot be used.
    """
    return resolved(read_yaml(path, SignalsFile), path.resolve().parent, str(path))


def resolved(file: SignalsFile, folder: Path, where: str) -> SignalsFile:
    """Returns `file` with its file of changes, in `folder`, replaced by the changes; `where` names it in errors."""
    if file.states is None:
        return file
    changes = _read_changes(file.states, folder / file.states.file)
    unknown = sorted({group for _, group, _ in changes} - set(file.groups))
    if unknown:
        raise InputError(
            f"{where}: field groups: group {', '.join(unknown)} of {file.states.file} is missing; one that is not "
            f"needed has an empty list"
        )
    return SignalsFile(groups=file.groups, changes=changes)


def on_clock(file: SignalsFile, zero_s: float, slower: float = 1.0) -> SignalsFile:
    """Returns a resolved `file` with times counted from `zero_s` [s], those of changes multiplied by `slower` before.

    Durations of a program stay as they are.
    """
    if file.program is not None:
        program = file.program.model_copy(update={"offset_s": file.program.offset_s - zero_s})
        return file.model_copy(update={"program": program})
    changes = [(round(slower * begin - zero_s, 6), group, state) for begin, group, state in file.changes or []]
    return file.model_copy(update={"changes": changes})


def build(file: SignalsFile, net: Path, log: Log, start_frame: int, where: str, *, as_recorded: bool = True) -> Signals:
    """Returns the signals of a scenario, of a resolved `file`.

    Raises an InputError, in which `where` names the scenario, if a connection is not in the net, or is in two
    groups; or most vehicles of the log pass the stop lines of a group at red though they saw the signals,
    `as_recorded`, so that groups or times must be wrong.
    """
    signals = signals_of(file, read_links(net), log.steps, start_frame, where)
    if as_recorded:
        check_passages(count_passages(signals, log), where)
    return signals


def signals_of(
    file: SignalsFile, net_links: Sequence[SignalLink], steps: int, start_frame: int = 0, where: str = "signals"
) -> Signals:
    """Returns the signals for `steps` steps from `start_frame` on, without the check that vehicles heed them.

    Raises an InputError, in which `where` names the scenario, if a connection is not in the net, or is in two
    groups; or a group of a program is unknown.
    """
    members = members_of(file.groups, net_links, f"{where}: signals, field groups")
    groups = tuple(sorted(set(members.values())))
    links = tuple(link for link in net_links if link.name in members)
    changes = file.changes if file.changes is not None else _cycle(file, start_frame, steps, where)
    states = _states(changes, groups, start_frame, steps)
    link_group = np.array([groups.index(members[link.name]) for link in links], np.int64)
    return Signals(groups, links, link_group, states)


def members_of(groups: Mapping[str, Sequence[str]], links: Sequence[SignalLink], where: str) -> dict[str, str]:
    """Returns the group of each connection of `links` that `groups` name, by its name.

    Raises an InputError, in which `where` names the groups, if one is not among them, or is in two groups; or none is.
    """
    by_name: dict[str, list[str]] = {}
    for link in links:
        by_name.setdefault(link.name, []).append(link.name)
        by_name.setdefault(link.from_lane, []).append(link.name)
        by_name.setdefault(link.from_lane.rpartition("_")[0], []).append(link.name)
    members: dict[str, str] = {}
    for group, names in groups.items():
        for name in names:
            plain = ARROW.join(part.strip() for part in name.split(ARROW.strip()))
            if plain not in by_name:
                edges = sorted({link.from_lane.rpartition("_")[0] for link in links})
                near = difflib.get_close_matches(plain, by_name, 3, 0.4) or edges
                raise InputError(
                    f"{where}.{group}: {name}: the net has no such controlled connection, lane or edge; "
                    + (f"near: {', '.join(near)}" if near else "it has no traffic lights")
                )
            for member in by_name[plain]:
                if members.setdefault(member, group) != group:
                    raise InputError(f"{where}: {member} is in groups {members[member]} and {group}, expected one")
    if not members:
        raise InputError(f"{where}: no group controls a connection")
    return members


def _cycle(file: SignalsFile, start_frame: int, steps: int, where: str) -> list[tuple[float, str, str]]:
    """Returns the changes of a fixed cycle that determine the states of `steps` steps from `start_frame` on."""
    program = file.program
    assert program is not None  # SignalsFile has checked
    unknown = sorted({group for phase in program.phases for group in phase.states} - set(file.groups))
    if unknown:
        raise InputError(f"{where}: signals, field program: group {', '.join(unknown)} is not among groups")
    cycle = sum(phase.duration_s for phase in program.phases)
    first = start_frame * STEP_S
    begin = program.offset_s + cycle * np.floor((first - program.offset_s) / cycle)
    changes: list[tuple[float, str, str]] = []
    while begin <= first + steps * STEP_S:
        for phase in program.phases:
            changes += [(begin, group, phase.states.get(group, "red")) for group in file.groups]
            begin += phase.duration_s
    return changes


def _states(
    changes: Sequence[tuple[float, str, str]],
    groups: tuple[str, ...],
    start_frame: int,
    steps: int,
) -> ByteArray:
    """Returns states (g, steps); UNAVAILABLE before the first change of a group."""
    states = np.full((len(groups), steps), int(SignalState.UNAVAILABLE), np.uint8)
    rows = {group: row for row, group in enumerate(groups)}
    for begin, group, state in changes:
        if group in rows:
            step = int(np.ceil(begin * RATE_HZ - 1e-6)) - start_frame
            states[rows[group], max(0, step) :] = int(NAMES[state])
    return states


def count_passages(signals: Signals, log: Log, until: int | None = None) -> dict[str, tuple[int, int]]:
    """Returns the numbers of vehicles of the log that pass the stop lines, in total and at red, by group.

    Passages after step `until` do not count, so that later steps show the way taken; None for the last of the log.
    """
    passages = crossings(signals.links, log.x, log.y, log.yaw, log.length, log.valid & ~log.obstacle[:, None])
    counted = passages.step <= (log.steps if until is None else until)
    group = signals.link_group[passages.link[counted]]
    red = np.isin(signals.states[group, passages.step[counted]], STOP_STATES)
    return {name: (int((group == row).sum()), int(red[group == row].sum())) for row, name in enumerate(signals.groups)}


def check_known(file: SignalsFile, is_known: bool, frames: tuple[int, int], where: str) -> None:
    """Refuse signals of which no group's state `is_known` within `frames`, first and last, of the recording.

    Raises an InputError, in which `where` names the signals.
    """
    if is_known:
        return
    begins = [begin for begin, *_ in file.changes or []]
    first = f"the first change is at {min(begins):g} s" if begins else "there are no changes"
    begin, end = (frame * STEP_S for frame in frames)
    raise InputError(
        f"{where}: field signals: no group shows anything from {begin:g} to {end:g} s, counted from frame 0, and "
        f"{first}: are unit and clock right?"
    )


def check_passages(counts: Mapping[str, tuple[int, int]], where: str) -> None:
    """Raise InputError about signals that most vehicles do not heed, by the counts of :func:`count_passages`."""
    for name, (passed, at_red) in counts.items():
        if passed >= PASSED_MIN and at_red > AT_RED_MAX * passed:
            raise InputError(
                f"{where}: field signals: group {name}: {at_red} of {passed} vehicles pass its stop lines at red: are "
                f"its connections and times right?"
            )


def _read_changes(states: StateList, path: Path) -> list[tuple[float, str, Any]]:
    """Returns the changes of a file, ascending by time."""
    require_file(path, "file of signal states")
    source = TableFile.open(path)
    table = _changes_table(states, source)
    from pandas import to_numeric  # imported here, as runs without such a file do not need it

    stamped = is_stamped(table["begin"])
    begin = to_numeric(seconds_of(table["begin"]) if stamped else table["begin"], errors="coerce").to_numpy(np.float64)
    if not np.isfinite(begin).all():
        bad = int(np.argmin(np.isfinite(begin)))
        value = str(table["begin"].iloc[bad])
        raise InputError(
            f"{source.place(table['row'].iloc[bad])}: column {states.begin!r} is {value!r}, expected a number"
        )
    for column in ("group", "state"):
        if table[column].isna().any():
            row = table[table[column].isna()].iloc[0]
            named = getattr(states, column) if isinstance(states.group, str) else row["group"]
            raise InputError(f"{source.place(row['row'])}: column {named!r} is empty")
    codes = {str(code): name for code, name in states.codes.items()}
    state = table["state"].map(_plain)
    names = state.map(lambda value: codes.get(value, value.lower() if value.lower() in NAMES else None))
    if names.isna().any():
        bad = int(np.argmax(names.isna().to_numpy()))
        place = source.place(table["row"].iloc[bad])
        raise InputError(
            f"{place}: state {state.iloc[bad]!r} is none of {', '.join(NAMES)}; say in field codes what it is"
        )
    order = np.argsort(begin, kind="stable")
    group = table["group"].map(_plain).to_numpy()
    seconds = [round(float(time), 6) for time in begin * (1.0 if stamped else SECONDS[states.unit])]
    first_at: dict[tuple[str, float], int] = {}
    for i in order:
        first = first_at.setdefault((group[i], seconds[i]), i)
        if NAMES[names.iloc[i]] != NAMES[names.iloc[first]]:
            own, other = (f"{source.place(table['row'].iloc[k])}, {names.iloc[k]}" for k in (first, i))
            raise InputError(f"{own}; {other}: group {group[i]} shows two states at one time, expected one")
    return [(seconds[i], str(group[i]), str(names.iloc[i])) for i in order]


def _changes_table(states: StateList, source: TableFile) -> pd.DataFrame:
    """Returns columns group, begin, state and row of a file, with a row for each change of one group."""
    import pandas as pd

    if isinstance(states.group, str):
        columns = {"group": states.group, "begin": states.begin, "state": states.state}
        table = source.read(sorted({*columns.values()}), may_be_empty=True)
        return pd.DataFrame({ours: table[theirs] for ours, theirs in columns.items()} | {"row": table["row"]})
    table = source.read(sorted({states.begin, *states.group}), may_be_empty=True)
    parts = [
        pd.DataFrame({"group": name, "begin": table[states.begin], "state": table[name], "row": table["row"]})
        for name in states.group
    ]
    return pd.concat(parts, ignore_index=True)


def _plain(value: object) -> str:
    """Returns a group or code as text; 3 and 3.0 are the same."""
    return str(value).strip().removesuffix(".0")
