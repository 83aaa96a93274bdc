"""Kinds of road users: what files most probably mean by theirs, and their translation by a mapping."""

from __future__ import annotations

import re
from typing import get_args

import numpy as np
import pandas as pd

from litsim_data.generic.counts import Counts
from litsim_data.generic.mapping import FACTORS, KindName, Mapping
from litsim_data.generic.obstacles import NAMES as OBSTACLES
from litsim_data.generic.reading import plain, texts
from litsim_data.generic.resampling import HOLE_MAX_S
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.io.table_input import TableFiles, is_stamped, seconds_of

DROP, UNKNOWN = "drop", "unknown"

KINDS: dict[str, str] = {
    "car": r"car|van|suv|taxi|auto|passenger.*|vehicle|.*\.car",
    "truck": r"(.*\.)?truck.*|(.*\.)?bus(\..*)?|lorry|(.*\.)?trailer|heavy.*|medium.*",
    "motorcycle": r"(.*\.)?motor_?(cycl|bik).*|moped|scooter",
    "drop": r"ped.*|person|human.*|walker.*|(.*\.)?bi?cycl.*|bike.*|cyclist|riderless.*|animal|static.*|movable.*"
    r"|background|construction|unknown_obstacle",
}
"""Pattern of a file's kinds, in lower case, by our name."""
NUMBERED = {"1": "motorcycle", "2": "car", "3": "truck"}
"""Our names of NGSIM's numbers, whose column is `v_class`; numbers of other data sets mean something else."""


def likely_kind(name: str) -> str:
    """Returns what a file most probably means by a kind, as field `kinds` of a mapping has it."""
    return next((ours for ours, like in KINDS.items() if re.fullmatch(like, name.lower())), "unknown")


def without_dropped_kinds(raw: pd.DataFrame, mapping: Mapping, source: TableFiles, counts: Counts) -> pd.DataFrame:
    """Returns the rows of kinds that the mapping keeps, with column `kind` translated by it."""
    if "kind" not in raw:
        return raw
    kind_names, kinds = texts(raw["kind"]), {plain(name): ours for name, ours in mapping.kinds.items()}
    if missing := sorted(set(kind_names.unique()) - set(kinds)):
        row = raw["row"][kind_names == missing[0]].iloc[0]
        entries = ", ".join(f"{name!r}: {likely_kind(name)}" for name in missing)
        raise InputError(
            f"{source.place(row)}: kind {missing[0]!r} is not in field kinds of the mapping, which needs an entry for "
            f"each value of column {mapping.columns.kind!r}, one of {', '.join(get_args(KindName))}: for those that "
            f"are missing, probably kinds: {{{entries}}}"
        )
    row_kind = kind_names.map(kinds)
    ours = _of_whole_tracks(row_kind, raw, mapping, counts)
    for kind in sorted(set(kind_names[row_kind == DROP])):
        counts.leave_out(f"kind {kind}", int(((kind_names == kind) & (ours == DROP)).sum()))
    counts.leave_out("of a track most of whose rows are dropped", int(((row_kind != DROP) & (ours == DROP)).sum()))
    if unknown := sorted(set(kind_names[ours == UNKNOWN])):
        vehicles = [int(raw["vehicle_id"][kind_names == kind].nunique()) for kind in unknown]
        listed = ", ".join(f"{kind or 'empty'} {number}" for kind, number in zip(unknown, vehicles, strict=True))
        of_kinds = f"{sum(vehicles)} vehicles are of a kind that field kinds of the mapping calls unknown"
        counts.tell("unknown", f"{of_kinds}: {listed}")
    if ours.isin([DROP, *OBSTACLES]).all():
        every = (
            "field kinds of the mapping drops every row"
            if (ours == DROP).all()
            else "only pedestrians and cyclists are left"
        )
        raise InputError(f"{source}: {every}; the kinds are {sorted(set(kind_names))}")
    return raw.assign(kind=ours)[ours != DROP]


def _of_whole_tracks(row_kind: pd.Series, raw: pd.DataFrame, mapping: Mapping, counts: Counts) -> pd.Series:
    """Returns, for each row of `raw`, the kind that most rows of its track have, as trackers change their minds.

    Tracks end at long holes: trackers use an id again for another object.
    """
    ids, _ = pd.factorize(raw["vehicle_id"])
    kinds, names = pd.factorize(row_kind)
    if (pd.DataFrame({"id": ids, "kind": kinds}).drop_duplicates()["id"].value_counts() == 1).all():
        return row_kind
    if mapping.columns.time is not None and is_stamped(raw["time"]):
        t = seconds_of(raw["time"]).to_numpy(np.float64)
    else:  # NaN for cells that are no time
        by_frame = mapping.columns.time is None
        name, unit = ("frame", 1.0 / mapping.rate_hz) if by_frame else ("time", FACTORS[mapping.units.time])
        t = pd.to_numeric(raw[name], errors="coerce").to_numpy(np.float64, na_value=np.nan) * unit
    order = np.lexsort([t, ids])
    begins = np.r_[True, (np.diff(ids[order]) != 0) | (np.diff(t[order]) > HOLE_MAX_S + STEP_S)]
    track = np.empty(len(ids), np.int64)
    track[order] = np.cumsum(begins) - 1
    rows = np.zeros((track.max() + 1, len(names)), np.int64)
    np.add.at(rows, (track, kinds), 1)
    if changing := int(((rows > 0).sum(axis=1) > 1).sum()):
        counts.tell("kinds", f"{changing} tracks change their kind: each is what most of its rows say")
    return pd.Series(np.asarray(names)[rows.argmax(axis=1)][track], index=row_kind.index)
