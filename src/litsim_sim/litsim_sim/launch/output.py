"""The folder of a recording, checked and held before anything of the run is started."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import try_lock

OF_MANY_RUNS = "campaign.json"
"""File by which a folder is known as that of many runs, which no single run is recorded into."""


def check_output(out: Path, overwrite: bool) -> None:
    """Make `out` if it is missing; raises InputError if it holds a recording and not `overwrite`, or cannot be."""
    if out.is_dir() and any(out.glob("*.mcap")) and not overwrite:
        raise InputError(f"{out}: holds a recording already; give another folder (out), or overwrite it")
    if (out / OF_MANY_RUNS).exists():
        raise InputError(f"{out}: the folder of a campaign, expected one of a run; give another --out")
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / f".{out.resolve().name}_0.mcap"  # the longest name of a file there, but hidden
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from error


@contextmanager
def held_output(out: Path) -> Iterator[None]:
    """Hold the folder `out` for one run until its measures are written, so that no other run's files pass for its own.

    The lock is one of the operating system: it is gone with the process, however that ends.

    Raises:
        InputError: another run holds it.
    """
    descriptor = os.open(out, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if not try_lock(descriptor):
            raise InputError(f"{out}: another run is recorded there; give another folder (out), or wait")
        yield
    finally:
        os.close(descriptor)
