"""A run in one process, as a program."""

import signal
from collections.abc import Iterator

import pytest

from command_line import status
from litsim_eval.cli import run
from litsim_sim.core.errors import EXIT_INTERRUPTED
from litsim_sim.launch.signals import SIGNALS


@pytest.fixture
def _handlers() -> Iterator[None]:
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}  # also where nohup ignores one
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("_handlers")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_one_that_is_ended_says_so_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], number: signal.Signals
) -> None:
    monkeypatch.setattr(run, "run", lambda _: signal.raise_signal(number))
    assert status(run.main, "--scenario", "demo", "--ego", "idm", "--policy", "litsim") == EXIT_INTERRUPTED
    assert capsys.readouterr().err == "\ninterrupted: the run is not measured\n"
