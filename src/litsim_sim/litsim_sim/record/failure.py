"""Why a run has failed, beside its recording: what who watched it saw, and the recording itself cannot hold."""

from __future__ import annotations

from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing
from litsim_sim.record.bag import FAILURE_FILE


def write_failure(folder: Path, reason: str) -> None:
    """Leave in the `folder` of a run, for :func:`read_failure`, in one line why the run has failed.

    Raises:
        Unwritable: it cannot be written.
    """
    with replacing(folder / FAILURE_FILE) as new:
        new.write_text(" ".join(reason.split()) + "\n", encoding="utf-8")


def read_failure(mcap: Path) -> str:
    """Why the run has failed whose recording is the file `mcap`; empty where nobody has said so.

    Raises:
        InputError: the file that says so cannot be read.
    """
    file = mcap.parent / FAILURE_FILE
    if not file.is_file() or len(list(mcap.parent.glob("*.mcap"))) > 1:  # of several, it is not known whose it is
        return ""
    try:
        return " ".join(file.read_text(encoding="utf-8").split())
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read: {error}") from error
