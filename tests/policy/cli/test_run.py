"""A run in one process, as a program."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from litsim_sim.core.errors import EXIT_INTERRUPTED


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_one_that_is_ended_says_so_in_a_line(number: signal.Signals) -> None:
    words = ["-m", "litsim_policy.cli.run", "--scenario", "demo", "--ego", "idm", "--policy", "litsim"]
    with subprocess.Popen([sys.executable, *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stderr is not None and process.stdout is not None
        process.stderr.read(1)  # of the progress bar
        process.send_signal(number)
        out, err = process.communicate(timeout=100)
    assert (process.returncode, out) == (EXIT_INTERRUPTED, b"")
    assert err.splitlines()[-1] == b"interrupted: the run is not measured"
    assert b"Traceback" not in err
