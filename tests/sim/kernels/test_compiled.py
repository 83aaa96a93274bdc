"""Compiled kernels: what they take, and what is kept of them on disk."""

import subprocess
import sys
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import numpy as np
import pytest
from numba import TypingError

from litsim_sim.kernels import compiled
from litsim_sim.kernels.ahead_of_time import compile_kernels, import_kernels, missing_kernels
from litsim_sim.kernels.compiled import KERNELS, Bools2, Floats, Kernel, OutFloats, cache_directory, kernel

SCALE = 3.0
SHAPE = (2, 2)


@kernel
def total(values: Floats) -> float:
    found = 0.0
    for value in values:
        found += SCALE * value
    return found


@kernel
def running_total(values: Floats, sums: OutFloats) -> None:
    for k in range(len(values)):
        sums[k] = total(values[: k + 1])


@kernel
def doubled_and_halved(values: Floats) -> tuple[Floats, Floats]:
    return 2.0 * values, 0.5 * values


class Share(NamedTuple):
    factor: float
    offset: float


@kernel
def shared(value: float, share: Share) -> float:
    return share.factor * value + share.offset


class Scaled(NamedTuple):
    values: Floats
    used: Bools2
    share: Share


@kernel
def total_of_used(scaled: Scaled) -> float:
    doubled = Share(2.0 * scaled.share.factor, scaled.share.offset)
    found = 0.0
    for k in range(len(scaled.values)):
        if scaled.used[0, k]:
            found += shared(scaled.values[k], doubled)
    return found


def test_a_kernel_takes_arrays_of_its_types_writable_or_not() -> None:
    values, sums = np.arange(4.0), np.zeros(4)
    values.flags.writeable = False
    running_total(values, sums)
    assert sums.tolist() == [0.0, 3.0, 9.0, 18.0]
    running_total(np.ones(4), sums)
    assert sums.tolist() == [3.0, 6.0, 9.0, 12.0]
    assert total(np.arange(8.0).reshape(4, 2)[:, 1]) == 48.0
    for wrong in (values.astype(np.float32), np.zeros((2, 2)), 1.0):
        with pytest.raises(TypeError):
            total(wrong)
    for wrong in (values, np.zeros((4, 2))[:, 0]):  # not writable, not contiguous
        with pytest.raises(TypeError):
            running_total(np.ones(4), wrong)


def test_a_kernel_takes_named_tuples_whose_fields_fit_their_annotations() -> None:
    values, used = np.arange(8.0).reshape(4, 2)[:, 1], np.array([[True, False, True, True]])
    assert total_of_used(Scaled(values, used, Share(3.0, 1.0))) == 6.0 * (1.0 + 5.0 + 7.0) + 3.0
    values = np.ones(4)
    values.flags.writeable = False
    assert total_of_used(Scaled(values, used, Share(1, 0))) == 6.0
    for wrong in (Scaled(values.astype(np.float32), used, Share(1.0, 0.0)), Scaled(values, used[0], Share(1.0, 0.0))):
        with pytest.raises(TypeError):
            total_of_used(wrong)
    with pytest.raises(TypeError):
        total_of_used((values, used, (1.0, 0.0)))


def test_a_kernel_that_returns_arrays_calls_nothing_of_python() -> None:
    """Else Ctrl-C could be raised in it, of which numba makes a SystemError, and each array would cost a call."""
    doubled_and_halved(np.ones(2))  # loaded
    called = []

    def notice(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            called.append(frame.f_code.co_name)

    sys.setprofile(notice)
    try:
        doubled, halved = doubled_and_halved(np.arange(3.0))
    finally:
        sys.setprofile(None)
    assert set(called) <= {"doubled_and_halved"}  # which numba reports itself, before Python 3.12
    assert (doubled.tolist(), halved.tolist()) == ([0.0, 2.0, 4.0], [0.0, 0.5, 1.0])


def test_sums_are_neither_reordered_nor_fused() -> None:
    values = np.random.default_rng(0).normal(size=1001) * 10.0 ** np.arange(-8, 8).repeat(63)[:1001]
    found = 0.0
    for value in values.tolist():
        found += SCALE * value
    assert total(values) == found != SCALE * values.sum()


@pytest.mark.parametrize(("dividend", "quotient"), [(1.0, np.inf), (-1.0, -np.inf), (0.0, np.nan)])
def test_division_by_zero_gives_what_numpy_gives(dividend: float, quotient: float) -> None:
    @kernel
    def divided(a: float, b: float) -> float:
        return a / b

    assert np.array_equal(divided(dividend, 0.0), quotient, equal_nan=True)


def test_a_kernel_of_what_the_disk_cannot_know_is_refused() -> None:
    with pytest.raises(TypeError, match="cannot use SHAPE"):

        @kernel
        def of_shape(k: int) -> int:
            return SHAPE[k]


def test_a_kernel_of_what_numba_has_no_type_for_is_refused() -> None:
    with pytest.raises(TypeError, match="str'> is no type of a kernel's arguments, expected a number, Floats"):

        @kernel
        def of_text(text: str) -> int:
            return len(text)


def test_a_kernel_of_what_is_defined_after_it_is_refused(tmp_path: Path) -> None:
    """What it is kept under on disk is made when it is defined."""
    folder = package(tmp_path)
    text = CALLED.format(package=folder.name) + "\n\nLATE = 2.0\n"
    (folder / "called.py").write_text(text.replace("FACTOR * a", "LATE * a"))
    run = start(folder)
    assert "TypeError: kernel called uses what is defined after it" in run.communicate()[1] and run.returncode


# What is kept on disk

FACTOR = "FACTOR = {}\n"
CALLED = """
from litsim_sim.kernels.compiled import kernel
from {package}.factor import FACTOR

@kernel
def called(a: float) -> float:
    return FACTOR * a
"""
CALLER = """
from litsim_sim.kernels.compiled import kernel
from {package}.called import called

@kernel
def caller(a: float) -> float:
    return 1.0 + called(a)
"""
RUN = "from {package}.caller import caller; print(caller(1.0), sum(caller.loaded.stats.cache_misses.values()))"


def package(tmp_path: Path, factor: float = 2.0, name: str = "made") -> Path:
    """A package with a kernel that calls another module's, which uses a constant of a third."""
    folder = tmp_path / name
    folder.mkdir(exist_ok=True)
    (folder / "__init__.py").touch()
    (folder / "factor.py").write_text(FACTOR.format(factor))
    for module, text in (("called", CALLED), ("caller", CALLER)):
        (folder / f"{module}.py").write_text(text.format(package=name))
    return folder


def start(folder: Path, code: str = RUN) -> subprocess.Popen[str]:
    """A Python that runs `code` beside the package `folder`; its second number counts what it had to compile.

    Bytecode of an equally long module that was written within the same second would be taken for that of the new one.
    """
    return subprocess.Popen(
        [sys.executable, "-B", "-c", code.format(package=folder.name)],
        cwd=folder.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def result(run: subprocess.Popen[str]) -> tuple[list[float], str]:
    """The numbers that a run printed, and what it said on stderr."""
    printed, said = run.communicate()
    assert run.returncode == 0, said
    return [float(word) for word in printed.split()], said


def test_machine_code_is_made_once_and_anew_when_a_constant_of_another_module_changes(tmp_path: Path) -> None:
    folder = package(tmp_path)
    assert result(start(folder)) == ([3.0, 1.0], "litsim: compiling kernels, once for this machine (about a minute)\n")
    assert result(start(folder)) == ([3.0, 0.0], "")
    package(tmp_path, factor=2.5)
    assert result(start(folder))[0] == [3.5, 1.0]


def test_kernels_are_loaded_before_a_run_but_for_those_that_only_others_call(tmp_path: Path) -> None:
    folder = package(tmp_path)
    which = "; print(*['loaded' in kernel.__dict__ for kernel in (caller, called)])"
    code = "from {package}.caller import caller, called; from litsim_sim.kernels.compiled import load_kernels" + which
    result(start(folder))  # compiled, so that the next one only loads
    run = start(folder, code + "; load_kernels()" + which)
    assert run.communicate()[0].split() == ["False", "False", "True", "False"]
    outer = CALLED.replace("import kernel", "import kernel, outer").replace("@kernel", "@outer\n@kernel")
    (folder / "called.py").write_text(outer.format(package=folder.name))
    result(start(folder))
    run = start(folder, code + "; load_kernels()" + which)
    assert run.communicate()[0].split() == ["False", "False", "True", "True"]


def test_machine_code_is_made_anew_when_the_fields_of_a_named_tuple_change(tmp_path: Path) -> None:
    folder = package(tmp_path)
    pair = "from typing import NamedTuple\nclass Pair(NamedTuple):\n    {}: float\n    {}: float\n"
    (folder / "called.py").write_text(
        "from litsim_sim.kernels.compiled import kernel\nfrom made.factor import Pair\n"
        "@kernel\ndef called(pair: Pair) -> float:\n    return pair.first\n"
    )
    code = (
        "from made.called import Pair, called as f; print(f(Pair(1.0, 2.0)), sum(f.loaded.stats.cache_misses.values()))"
    )
    (folder / "factor.py").write_text(pair.format("first", "second"))
    assert result(start(folder, code))[0] == [1.0, 1.0]
    (folder / "factor.py").write_text(pair.format("second", "first"))
    assert result(start(folder, code))[0] == [2.0, 1.0]


def test_processes_may_compile_at_once(tmp_path: Path) -> None:
    folder = package(tmp_path)
    runs = [start(folder) for _ in range(2)]
    assert [result(run)[0][0] for run in runs] == [3.0] * 2
    assert result(start(folder)) == ([3.0, 0.0], "")


def test_a_package_is_compiled_ahead_of_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = package(tmp_path, name="made_ahead")
    monkeypatch.syspath_prepend(tmp_path)
    assert import_kernels("made_ahead") == ["made_ahead.called", "made_ahead.caller"]

    def missing() -> list[Kernel]:
        return [each for each in missing_kernels() if each.__module__.startswith("made_ahead")]

    assert [each.__name__ for each in missing()] == ["caller", "called"]
    assert len(list(compile_kernels(missing(), 2))) == 2
    assert not missing() and not list(compile_kernels(missing(), 2))
    assert result(start(folder)) == ([3.0, 0.0], "")


def test_a_kernel_that_cannot_be_compiled_ahead_of_time_is_an_error() -> None:
    @kernel
    def nameless(a: float) -> float:
        return a.name

    try:
        with pytest.raises(TypingError, match="Unknown attribute 'name'"):
            list(compile_kernels([nameless], 1))
    finally:
        KERNELS.remove(nameless)


def test_what_lies_in_a_folder_that_cannot_be_written_to_is_kept_with_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cache_directory(tmp_path / "open" / "a.py") == tmp_path / "open" / "__pycache__"
    (tmp_path / "closed").touch()  # a file: nothing can be made below it, not even by root
    assert cache_directory(tmp_path / "closed" / "a.py") == tmp_path / "cache" / "litsim" / "kernels"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "closed"))
    assert cache_directory(tmp_path / "closed" / "a.py") is None


def test_a_kernel_runs_where_nothing_can_be_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "cache_directory", lambda source: None)

    @kernel
    def twice(a: float) -> float:
        return 2.0 * a

    assert twice(1.5) == 3.0
