"""Files of a data set that belong to a recording and lie beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from litsim_sim.core.errors import InputError


def the_map(path: Path, patterns: Sequence[str], what: str) -> Path:
    """Returns the only file in the folder of `path` that fits one of `patterns`.

    Raises:
        InputError: there is none, or several; `what` names it.
    """
    files = sorted({file for pattern in patterns for file in path.parent.glob(pattern)})
    if len(files) != 1:
        held = f"holds {', '.join(file.name for file in files[:5])}" if files else "holds none"
        raise InputError(f"{path}: {what}: {path.parent} {held}: name it by --map")
    return files[0]
