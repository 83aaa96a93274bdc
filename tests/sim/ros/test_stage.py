"""How a node's process takes signals."""

from __future__ import annotations

import signal

import pytest

from litsim_sim.ros import stage


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(stage.time, "monotonic", lambda: now[0])
    return now


def test_signals_that_come_together_interrupt_once_and_between_callbacks(clock: list[float]) -> None:
    interruption = stage._Interruption()
    for _ in range(3):
        interruption._on_signal(signal.SIGTERM, None)
        clock[0] += 0.01
    with pytest.raises(KeyboardInterrupt):
        interruption.check()
    interruption.check()


def test_a_second_signal_of_an_impatient_user_interrupts_at_once(clock: list[float]) -> None:
    interruption = stage._Interruption()
    interruption._on_signal(signal.SIGINT, None)
    clock[0] += 1.0
    with pytest.raises(KeyboardInterrupt):
        interruption._on_signal(signal.SIGINT, None)
