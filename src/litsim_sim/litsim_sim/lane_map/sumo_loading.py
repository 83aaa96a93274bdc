"""Loading of a net by SUMO in a process of its own: libsumo is one per process, and some nets crash it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

LOAD = "import libsumo, sys; libsumo.start(['sumo', '--no-step-log', '-n', *sys.argv[1:]]); libsumo.close()"


def begin_loading(net: Path, *options: str) -> subprocess.Popen[str]:
    """Begins to load `net` with further options of SUMO; returns the process, which tells warnings and errors."""
    return subprocess.Popen(
        [sys.executable, "-c", LOAD, str(net), *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )
