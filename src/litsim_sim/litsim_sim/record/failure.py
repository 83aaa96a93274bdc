"""The reason why a run has failed, in a file beside its recording, which cannot hold it."""

from __future__ import annotations

from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import write_text
from litsim_sim.record.bag import FAILURE_FILE


def write_failure(folder: Path, reason: str) -> None:
    """Write the reason, one line, to the `folder` of a failed run, for :func:`read_failure`; raises Unwritable."""
    write_text(folder / FAILURE_FILE, " ".join(reason.split()) + "\n")


def read_failure(mcap: Path) -> str:
    """Returns why the run recorded in the file `mcap` has failed; empty if no reason was written."""
    file = mcap.parent / FAILURE_FILE
    if not file.is_file() or len(list(mcap.parent.glob("*.mcap"))) > 1:  # of several, it is not known whose it is
        return ""
    try:
        return " ".join(file.read_text(encoding="utf-8").split())
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read: {error}") from error
