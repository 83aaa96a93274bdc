"""A run as two Parquet tables for pandas, polars, DuckDB and the like: states of agents by step, and takeovers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, fields
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from litsim_data.surrogates.encroachment import PET_HORIZON, times_since_others
from litsim_data.surrogates.safety import following, times_to_collision
from litsim_eval.analysis.measures.comfort import BOUNDS, motion_values
from litsim_eval.analysis.measures.takeover import LedgerEntry, ledger
from litsim_sim.core.scene import Controller
from litsim_sim.core.steps import StackedTable, Steps
from litsim_sim.io.files import replacing
from litsim_sim.record.run import Run

SERIES_FILE = "series.parquet"
TAKEOVERS_FILE = "takeovers.parquet"
ROWS_MAX = 100_000  # of a group of rows in the file
WORDS = ["controller", "takeover", "reason", "outcome"]  # dictionary-encoded columns
RUN_KEYS = ("run_id", "scenario", "ego", "policy", "seed")

TEXT = pa.dictionary(pa.int8(), pa.string())
SERIES = pa.schema(
    [
        ("step", pa.int32()),
        ("time_s", pa.float64()),
        ("agent", pa.int64()),
        ("controller", TEXT),
        ("takeover", TEXT),
        ("x_m", pa.float64()),
        ("y_m", pa.float64()),
        ("yaw_rad", pa.float64()),
        ("length_m", pa.float32()),
        ("width_m", pa.float32()),
        ("speed_mps", pa.float64()),
        ("acceleration_mps2", pa.float64()),
        ("yaw_rate_radps", pa.float64()),
        ("lateral_acceleration_mps2", pa.float64()),
        ("yaw_acceleration_radps2", pa.float64()),
        ("longitudinal_jerk_mps3", pa.float64()),
        ("jerk_mps3", pa.float64()),
        ("comfortable", pa.bool_()),
        ("leader", pa.int64()),
        ("gap_m", pa.float64()),
        ("headway_s", pa.float64()),
        ("drac_mps2", pa.float64()),
        ("ttc_s", pa.float64()),
        ("pet_s", pa.float64()),
        ("pet_agent", pa.int64()),
        ("deviation_m", pa.float64()),
        ("speed_deviation_mps", pa.float64()),
    ]
)
"""Columns of the series; defined in docs/metrics.md."""

_TYPES = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_(), "str": TEXT}
_TYPES |= dict.fromkeys(("TakeoverOutcome", "Place"), pa.string())
TAKEOVERS = pa.schema(
    (field.name, pa.int32() if field.name.endswith("_step") else _TYPES[str(field.type).removesuffix(" | None")])
    for field in fields(LedgerEntry)
)
"""Columns of the takeovers: the fields of :class:`litsim_eval.analysis.measures.takeover.LedgerEntry`."""

_MOTION = {  # bounded quantity of comfort: column
    "lateral_acceleration": "lateral_acceleration_mps2",
    "yaw_acceleration": "yaw_acceleration_radps2",
    "longitudinal_jerk": "longitudinal_jerk_mps3",
    "jerk": "jerk_mps3",
}


def series_tables(run: Run) -> Iterator[pa.Table]:
    """Yields one row per agent and step after the history, sorted by step and id; columns as SERIES.

    Missing values are null, never NaN or infinite. Each table has whole steps, and up to ROWS_MAX rows if these have
    no more; there is one table at least.
    """
    for begin, end in [*run.simulated.blocks(ROWS_MAX)] or [(0, 0)]:
        yield _series_table(run, begin, end)


def _series_table(run: Run, begin: int, end: int) -> pa.Table:
    """Returns the rows of :func:`series_tables` of the simulated steps `begin` to `end`, exclusive."""
    lead = max(0, begin - PET_HORIZON)  # steps before, on which those of the table depend
    steps, log = (whole.part(lead, end) for whole in (run.simulated, run.simulated_log))
    table = steps.stacked
    columns = {name: getattr(table, field) for name, field in _STATES.items()}
    columns["step"] = steps.step[table.number]
    columns["time_s"] = columns["step"] * run.info.dt
    columns |= _surroundings(steps) | _deviations(table, log)
    columns |= _motion(columns, run.info.dt)
    own = slice(int(steps.begin[begin - lead]), None)
    columns = {name: values[own] for name, values in columns.items()}
    arrays = {name: _array(values, SERIES.field(name).type) for name, values in columns.items()}
    arrays["controller"] = pa.array([_CONTROLLERS.get(mode) for mode in table.controller[own].tolist()], TEXT)
    among = range(int(steps.step[begin - lead]), int(steps.step[-1]) + 1) if len(steps) else range(0)
    states = {(step, t.agent): t.state.name.lower() for step in among for t in run.takeovers.get(step, ())}
    keys = zip(columns["step"].tolist(), columns["agent"].tolist(), strict=True)
    arrays["takeover"] = pa.array([states.get(key) for key in keys], TEXT)
    return _about(run, pa.table([arrays[name] for name in SERIES.names], schema=SERIES))


def takeovers_table(run: Run) -> pa.Table:
    """Returns one row per takeover, in order of detection; columns as TAKEOVERS."""
    return _about(run, pa.Table.from_pylist([asdict(entry) for entry in run.once(ledger)], schema=TAKEOVERS))


def write_tables(run: Run, folder: Path) -> None:
    """Writes :data:`SERIES_FILE` and :data:`TAKEOVERS_FILE` to `folder`.

    Raises:
        InputError: they cannot be written.
    """
    for name, tables in ((SERIES_FILE, series_tables(run)), (TAKEOVERS_FILE, iter([takeovers_table(run)]))):
        first = next(tables)
        with (
            replacing(folder / name) as path,
            pq.ParquetWriter(path, first.schema, compression="zstd", use_dictionary=WORDS) as writer,
        ):
            for table in chain([first], tables):
                writer.write_table(table)


_STATES = {
    "agent": "id",
    "x_m": "x",
    "y_m": "y",
    "yaw_rad": "yaw",
    "length_m": "length",
    "width_m": "width",
    "speed_mps": "speed",
    "acceleration_mps2": "acceleration",
    "yaw_rate_radps": "yaw_rate",
}
_CONTROLLERS = {controller.value: controller.name.lower() for controller in Controller}


def _surroundings(tables: Steps) -> dict[str, np.ndarray]:
    """Returns measures between each agent and the others; missing values are infinite, missing ids -1."""
    stacked = tables.stacked
    rows = np.arange(len(stacked))
    leaders = following(stacked, rows)
    there = leaders.leader >= 0
    pet, other = times_since_others(tables)
    return {
        "leader": np.where(there, stacked.id[leaders.leader], -1),
        "gap_m": leaders.gap,
        "headway_s": leaders.headway,
        "drac_mps2": np.where(there, leaders.drac, np.inf),
        "ttc_s": times_to_collision(stacked, rows),
        "pet_s": pet,
        "pet_agent": other,
    }


def _deviations(table: StackedTable, log: Steps) -> dict[str, np.ndarray]:
    """Returns the distance from the logged pose, and speed minus the logged one; NaN where the log lacks the agent."""
    rows = log.rows_at(table.number, table.id)
    both = rows >= 0
    now, then = table.take(both), log.stacked.take(rows[both])
    far, faster = np.full((2, len(table)), np.nan)
    far[both], faster[both] = np.hypot(now.x - then.x, now.y - then.y), now.speed - then.speed
    return {"deviation_m": far, "speed_deviation_mps": faster}


def _motion(columns: dict[str, np.ndarray], dt: float) -> dict[str, np.ndarray]:
    """Returns the quantities bounded by comfort; derivatives are NaN at an agent's first step."""
    order = np.lexsort((columns["step"], columns["agent"]))
    agent, step = columns["agent"][order], columns["step"][order]
    speed, acceleration, yaw_rate = (columns[n][order] for n in ("speed_mps", "acceleration_mps2", "yaw_rate_radps"))
    follows = (np.diff(agent) == 0) & (np.diff(step) == 1)
    columns_of_motion, comfortable = {}, np.ones(len(order), np.bool_)
    for name, values in motion_values(speed, acceleration, yaw_rate, dt).items():
        low, high = BOUNDS[name]
        column = np.full(len(order), np.nan)
        if len(values) == len(order):
            column[order] = values
        else:
            column[order[1:]] = np.where(follows, values, np.nan)
        comfortable &= ~((column < low) | (column > high))
        columns_of_motion[_MOTION.get(name, "")] = column
    columns_of_motion.pop("")  # recorded quantities, which have columns already
    return columns_of_motion | {"comfortable": comfortable}


def _array(values: np.ndarray, kind: pa.DataType) -> pa.Array:
    """Returns a column with null for values that are not finite and for negative ids."""
    nothing = ~np.isfinite(values) if pa.types.is_floating(kind) else values < 0
    return pa.array(values, mask=nothing & (values.dtype != np.bool_)).cast(kind)


def _about(run: Run, table: pa.Table) -> pa.Table:
    """Returns `table` with the run id as its first column, and RUN_KEYS as metadata."""
    about = {key: str(getattr(run.info, key)) for key in RUN_KEYS}
    run_id = pa.array([run.info.run_id] * len(table), TEXT)
    return table.add_column(0, "run_id", run_id).replace_schema_metadata(about)
