"""How a node's process takes signals."""

import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import domain_coordinator
import pytest

from litsim_sim.ros import process


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(process.time, "monotonic", lambda: now[0])
    return now


def test_signals_that_come_together_interrupt_once_and_between_callbacks(clock: list[float]) -> None:
    interruption = process._Interruption()
    for _ in range(3):
        interruption._on_signal(signal.SIGTERM, None)
        clock[0] += 0.01
    with pytest.raises(KeyboardInterrupt):
        interruption.check()
    interruption.check()


def test_a_second_signal_of_an_impatient_user_interrupts_at_once(clock: list[float]) -> None:
    interruption = process._Interruption()
    interruption._on_signal(signal.SIGINT, None)
    clock[0] += 1.0
    with pytest.raises(KeyboardInterrupt):
        interruption._on_signal(signal.SIGINT, None)


@pytest.mark.parametrize("word", ["-h", "--help"])
def test_help_of_a_node(word: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["/somewhere/predictor", word])
    with pytest.raises(SystemExit) as stopped:
        process._init()
    assert stopped.value.code == 0
    said = capsys.readouterr().out
    assert said.startswith("usage: predictor [--ros-args -p NAME:=VALUE")
    assert "config/predictor.yaml" in said


def test_a_path_that_the_system_refuses_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(process, "_init", lambda *_: None)
    monkeypatch.setattr(process, "_interruption", process._Interruption())
    monkeypatch.setattr(process.signal, "signal", lambda *_: None)
    with pytest.raises(SystemExit) as stopped, process.process():
        Path("n" * 300).is_dir()
    assert (stopped.value.code, capsys.readouterr().err) == (2, f"error: {'n' * 300}: File name too long\n")


def test_an_rclpy_without_an_events_executor_is_served_by_its_ordinary_one() -> None:
    """In a process of its own: rclpy before 7.1.4 has no `rclpy.experimental`."""
    script = textwrap.dedent("""
        import sys
        sys.modules["rclpy.experimental"] = None  # as if it were not there
        import rclpy
        from std_msgs.msg import String
        from litsim_sim.ros.process import executor_of, serve
        rclpy.init(domain_id=int(sys.argv[1]))
        one, other, heard = rclpy.create_node("one"), rclpy.create_node("other"), []
        other.create_subscription(String, "said", lambda message: heard.append(message.data), 10)
        publisher, executor = one.create_publisher(String, "said", 10), executor_of(one, other)
        while not heard:
            publisher.publish(String(data="word"))
            serve(executor)
        print(type(executor).__name__, heard[0])
        rclpy.shutdown()
    """)
    with domain_coordinator.domain_id() as domain:
        words = [sys.executable, "-c", script, str(domain)]
        done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["SingleThreadedExecutor", "word"]
