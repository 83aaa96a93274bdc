"""Tables of trajectories, as users have them, and what conversion makes of them."""

from pathlib import Path
from typing import Any

import pandas as pd

from litsim_data.generic.convert import convert
from litsim_data.generic.counts import Counts
from litsim_data.generic.mapping import Mapping
from litsim_sim.scenario.recording import Recording


def written(path: Path, table: pd.DataFrame) -> Path:
    """The file that a table is written to, CSV or Parquet by its name."""
    if path.suffix == ".csv":
        table.to_csv(path, index=False)
    else:
        table.to_parquet(path)
    return path


def converted(path: Path, table: pd.DataFrame, fields: dict[str, Any]) -> tuple[Recording, Counts]:
    """The recording that a table at `path` becomes by the fields of a mapping, and counts of the conversion."""
    return convert(written(path, table), Mapping.model_validate(fields))
