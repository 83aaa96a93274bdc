"""How programs end: errors in a line, exit statuses, no traceback where none helps."""

import errno
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from litsim_sim.cli.program import interrupt_on_signals, program, run_status
from litsim_sim.core.errors import InputError


def ended(work, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    with pytest.raises(SystemExit) as stop:
        program(work)()
    assert isinstance(stop.value.code, int)
    return stop.value.code, capsys.readouterr().err


def raising(error: BaseException):
    def work() -> None:
        raise error

    return work


def test_work_that_went_well_returns(capsys: pytest.CaptureFixture[str]) -> None:
    assert program(lambda: None)() is None and program(lambda: 0)() is None
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("work", "status", "said"),
    [
        (raising(InputError("a.yaml: field seed: no number")), 2, "error: a.yaml: field seed: no number\n"),
        (raising(KeyboardInterrupt()), 130, ""),
        (
            raising(ModuleNotFoundError("No module named 'torch'", name="torch")),
            2,
            "error: torch is not installed here, and this needs it: `make setup-all` installs it\n",
        ),
        (lambda: 1, 1, ""),
        (
            raising(PermissionError(errno.EACCES, "Permission denied", "/locked/a")),
            2,
            "error: /locked/a: Permission denied\n",
        ),
        (lambda: Path("n" * 300).is_file(), 2, f"error: {'n' * 300}: File name too long\n"),
    ],
)
def test_how_it_ended_is_the_exit_status(work, status: int, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(work, capsys) == (status, said)


def test_mistakes_of_ours_keep_their_traceback() -> None:
    with pytest.raises(ZeroDivisionError):
        program(lambda: 1 // 0)()
    with pytest.raises(FileNotFoundError):
        program(lambda: Path("missing").read_text())()


def test_arguments_are_passed_on() -> None:
    seen = []
    program(lambda *words, end: seen.append((words, end)))("a", "b", end="c")
    assert seen == [(("a", "b"), "c")]


def test_a_reader_that_has_gone_is_no_traceback() -> None:
    code = "from litsim_sim.cli.program import program\nprogram(lambda: print('x' * 10**6))()"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == "" and process.wait() == 1
    process.stderr.close()


def test_a_program_whose_output_is_closed_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    program(lambda: print("said"))()
    monkeypatch.setattr(sys, "stderr", None)
    with pytest.raises(SystemExit, match="1"):
        program(lambda: 1)()


def test_a_run_that_is_not_valid_fails_and_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_status({"valid": True, "why": ""}, "bags/a") == 0
    assert capsys.readouterr().err == ""
    assert run_status({"valid": False, "why": "3 gaps"}, "bags/a") == 1
    assert capsys.readouterr().err == "error: bags/a: the run is not valid: 3 gaps\n"


def test_to_be_ended_is_to_be_interrupted() -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as in the background of a script
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup
        interrupt_on_signals()
        for number in (signal.SIGINT, signal.SIGTERM):
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(number)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_a_module_of_ours_that_is_missing_is_no_bad_input() -> None:
    with pytest.raises(ModuleNotFoundError):
        program(raising(ModuleNotFoundError("No module named 'litsim_sim.core'", name="litsim_sim.core")))()


@pytest.mark.parametrize("package", ["litsim_sim", "litsim_data", "litsim_eval", "litsim_research"])
def test_interrupted_while_it_loads_a_program_says_nothing_but_other_errors_are_shown(package: str) -> None:
    def loading(error: str) -> subprocess.CompletedProcess[str]:
        words = [sys.executable, "-c", f"import {package}.cli\nraise {error}"]
        return subprocess.run(words, capture_output=True, text=True, check=False)

    interrupted, broken = loading("KeyboardInterrupt"), loading("ValueError('of no use')")
    assert (interrupted.returncode, interrupted.stderr) == (-signal.SIGINT, "")
    assert broken.returncode == 1 and broken.stderr.endswith("ValueError: of no use\n")
