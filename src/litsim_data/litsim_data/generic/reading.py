"""Reading of the columns and rows that a mapping selects from a CSV or Parquet file."""

from __future__ import annotations

import numpy as np
import pandas as pd

from litsim_data.generic.counts import Counts
from litsim_data.generic.mapping import Mapping, Span, Value, Vehicles
from litsim_sim.core.errors import InputError
from litsim_sim.io.table_input import TableFile, TableFiles, is_stamped

NEEDED = ("vehicle_id", "frame", "time", "x", "y", "clip")  # columns required in each of several files
SHOWN = 12  # most values of a column that a message lists


def read_rows(source: TableFiles, mapping: Mapping, counts: Counts) -> pd.DataFrame:
    """Returns the columns that the mapping names, under our names, of the rows that it keeps; `row` holds their places.

    Raises:
        InputError: the file cannot be read, lacks a column, or has several clips of which none is chosen; or the
            mapping keeps no row.
    """
    columns = mapping.columns.named()
    wanted = {*columns.values(), *mapping.rows}
    own = {*source.columns, columns["vehicle_id"]} if mapping.vehicles is not None else wanted
    needed = {columns[name] for name in NEEDED if name in columns} | {*mapping.rows}
    raw = source.read(sorted(wanted & own), needed=needed & own, whose="of the mapping")
    counts.read = len(raw)
    if mapping.vehicles is not None:
        raw = _with_vehicles(raw, sorted(wanted - own), mapping.vehicles, columns["vehicle_id"], source)
    raw = _filtered(raw, mapping, source, counts)
    raw = _of_one_clip(raw, mapping, source, counts)
    return pd.DataFrame({ours: raw[theirs] for ours, theirs in columns.items()} | {"row": raw["row"]})


def _with_vehicles(
    raw: pd.DataFrame, wanted: list[str], vehicles: Vehicles, vehicle_id: str, source: TableFiles
) -> pd.DataFrame:
    """Returns `raw` with the columns `wanted` added from the file `vehicles`, which has one row per vehicle.

    Raises:
        InputError: that file cannot be read, lacks a column or a vehicle, or has a vehicle twice.
    """
    other = TableFile.open(source.folder / vehicles.file)
    table = other.read(sorted({vehicles.vehicle_id, *wanted}), whose="of the mapping, field vehicles,")
    ids = texts(table[vehicles.vehicle_id])
    if (twice := ids.duplicated().to_numpy()).any():
        row = int(np.argmax(twice))
        raise InputError(
            f"{other.place(table['row'].iloc[row])}: vehicle {ids.iloc[row]} occurs a second time, "
            "expected one row for each"
        )
    theirs = texts(raw[vehicle_id])
    if (lost := ~theirs.isin(ids).to_numpy()).any():
        row = int(np.argmax(lost))
        raise InputError(
            f"{source.place(raw['row'].iloc[row])}: vehicle {theirs.iloc[row]} is not in {other}; "
            f"{theirs[lost].nunique()} such vehicles"
        )
    place = pd.Index(ids).get_indexer(pd.Index(theirs))
    return raw.assign(**{name: table[name].to_numpy()[place] for name in wanted})


def _filtered(raw: pd.DataFrame, mapping: Mapping, source: TableFiles, counts: Counts) -> pd.DataFrame:
    """Returns the rows that field `rows` of the mapping keeps."""
    for column, rule in mapping.rows.items():
        keep = _kept(raw[column], rule, f"{source}: field rows.{column}")
        if not keep.any():
            held = _values(raw[column])
            raise InputError(f"{source}: field rows.{column} of the mapping keeps no row; the column holds {held}")
        counts.leave_out(f"{column} is not {_words(rule)}", len(raw) - int(keep.sum()))
        raw = raw[keep]
    return raw


def _kept(values: pd.Series, rule: Value | list[Value] | Span, where: str) -> pd.Series:
    if isinstance(rule, Span):
        numbers = pd.to_numeric(values, errors="coerce")
        if numbers.isna().all() or is_stamped(values):
            raise InputError(f"{where}: min and max are for numbers; the column holds {_values(values)}")
        return numbers.between(rule.min, rule.max)
    wanted = {plain(value) for value in (rule if isinstance(rule, list) else [rule])}
    return values.map(plain).isin(wanted)


def _of_one_clip(raw: pd.DataFrame, mapping: Mapping, source: TableFiles, counts: Counts) -> pd.DataFrame:
    """Returns the rows of the clip that the mapping selects, or of the only one."""
    column = mapping.columns.clip
    if column is None:
        return raw
    clips = raw[column].map(plain)
    if mapping.clip is None:
        if len(clips.unique()) > 1:
            raise InputError(
                f"{source}: column {column!r} has several clips, {_values(raw[column])}; choose one by field clip of "
                f"the mapping, or by --clip"
            )
        return raw
    keep = clips == plain(mapping.clip)
    if not keep.any():
        raise InputError(f"{source}: no clip {mapping.clip!r} in column {column!r}, which has {_values(raw[column])}")
    counts.leave_out(f"of another clip than {mapping.clip}", len(raw) - int(keep.sum()))
    return raw[keep]


def texts(column: pd.Series) -> pd.Series:
    """Returns the values of a column of kinds or ids as normalised text, see :func:`plain`; empty for empty cells."""
    codes, names = pd.factorize(column, use_na_sentinel=False)
    plainly = np.array(["" if pd.isna(name) else plain(name) for name in names], object)
    return pd.Series(plainly[codes], index=column.index)


def plain(value: object) -> str:
    """Returns a value as normalised text for comparisons: 3, 3.0 and "3" are the same, and true, True and "True"."""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    text = str(value).strip()
    try:
        number = float(text)
    except ValueError:
        return text.lower() if text.lower() in ("true", "false") else text
    return text.removesuffix(".0") if number.is_integer() else repr(number)


def _values(column: pd.Series) -> str:
    values = [str(value) for value in column.dropna().unique()[: SHOWN + 1]]
    return ", ".join(values[:SHOWN]) + (" and more" if len(values) > SHOWN else "")


def _words(rule: Value | list[Value] | Span) -> str:
    if isinstance(rule, Span):
        return f"within [{rule.min:g}, {rule.max:g}]"
    return " or ".join(map(str, rule if isinstance(rule, list) else [rule]))
