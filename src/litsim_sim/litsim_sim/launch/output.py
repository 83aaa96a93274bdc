"""The folder of a recording, looked at before anything of the run is started."""

from __future__ import annotations

from pathlib import Path

from litsim_sim.core.errors import InputError


def check_output(out: Path, overwrite: bool) -> None:
    """Make the folder `out` where it is not there.

    Raises:
        InputError: it holds a recording already and not `overwrite`, or it cannot be written.
    """
    if out.is_dir() and any(out.glob("*.mcap")) and not overwrite:
        raise InputError(f"{out}: holds a recording already; give another folder (out), or overwrite it")
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".write"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from error
