"""A trial of SUMO with a net before a run, so that a net that it refuses is told before any node starts."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.sumo_loading import begin_loading
from litsim_sim.launch.child import how_it_ended
from litsim_sim.scenario.scenario import packaged

MARK = "Error: "  # begins the lines with SUMO's reasons
REASONS_MAX = 3


def begin_net_check(net: Path) -> Callable[[], None]:
    """Begin to load `net` in a process of its own, which a net may crash; returns a function that checks the result.

    That function raises an InputError with SUMO's reason if it cannot load the net. Packaged nets are not tried, nor
    those that were loaded before: that takes a quarter of a second.
    """
    mark = _mark_of(net)
    if net.resolve().parent == packaged("nets").resolve() or (mark and mark.is_file()):
        return lambda: None
    process = begin_loading(net, "--no-warnings")

    def check() -> None:
        output = process.communicate()[1]
        if process.returncode:
            reasons = [line.removeprefix(MARK) for line in output.splitlines() if line.startswith(MARK)]
            why = " ".join(reasons[:REASONS_MAX]) or f"it {how_it_ended(process.returncode)}"
            raise InputError(f"{net}: SUMO cannot load the net: {why}")
        if mark:
            with suppress(OSError):  # it is tried again next time
                mark.parent.mkdir(parents=True, exist_ok=True)
                mark.touch()

    return check


def _mark_of(net: Path) -> Path | None:
    """Returns the file in the user's cache that is there once this SUMO has loaded `net`; None without a folder."""
    with suppress(OSError, RuntimeError, PackageNotFoundError):  # no net, no home, or SUMO not from pip
        status = net.stat()
        tried = (net.resolve(), status.st_size, status.st_mtime_ns, version("libsumo"))
        cache = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
        return cache / "litsim/nets" / sha256(repr(tried).encode()).hexdigest()
    return None
