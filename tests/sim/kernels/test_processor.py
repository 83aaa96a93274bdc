"""numpy and OpenBLAS run the same code on every x86-64 processor with AVX2."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from litsim_sim.kernels.processor import CHOICE, CPUINFO, choose_code

AVX512 = "processor\t: 0\nflags\t\t: fpu sse2 fma avx2 avx512f\n"
ENABLED = "from numpy._core._multiarray_umath import __cpu_features__ as f; print(f['AVX2'], f['{}'])"


@pytest.fixture
def no_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a process that has not imported it yet."""
    monkeypatch.delitem(sys.modules, "numpy")


def cpuinfo(folder: Path, text: str) -> Path:
    path = folder / "cpuinfo"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.usefixtures("no_numpy")
def test_code_for_avx2_is_chosen_where_the_processor_has_it(tmp_path: Path) -> None:
    environment: dict[str, str] = {}
    choose_code(environment, cpuinfo(tmp_path, AVX512))
    assert environment == CHOICE


@pytest.mark.usefixtures("no_numpy")
def test_what_the_user_has_set_stays(tmp_path: Path) -> None:
    environment = {"OPENBLAS_CORETYPE": "SkylakeX"}
    choose_code(environment, cpuinfo(tmp_path, AVX512))
    assert environment == CHOICE | {"OPENBLAS_CORETYPE": "SkylakeX"}


@pytest.mark.usefixtures("no_numpy")
@pytest.mark.parametrize("text", ["flags : fpu sse2\n", "Features : fp asimd\n", ""])
def test_other_processors_are_left_alone(tmp_path: Path, text: str) -> None:
    environment: dict[str, str] = {}
    choose_code(environment, cpuinfo(tmp_path, text))
    choose_code(environment, tmp_path / "absent")
    assert environment == {}


def test_kernels_are_compiled_whatever_is_debugged(tmp_path: Path) -> None:
    environment = {"NUMBA_DISABLE_JIT": "1"}
    choose_code(environment, tmp_path / "absent")
    assert environment == {}


def test_nothing_is_chosen_for_others_once_numpy_is_imported(tmp_path: Path) -> None:
    environment: dict[str, str] = {}
    choose_code(environment, cpuinfo(tmp_path, AVX512))
    assert environment == {}


@pytest.mark.skipif(not CPUINFO.exists() or " avx512f " not in CPUINFO.read_text(encoding="utf-8"), reason="no AVX-512")
@pytest.mark.parametrize("package", ["litsim_sim", "litsim_predictor", "litsim_policy"])
def test_numpy_keeps_to_avx2_in_every_package(package: str) -> None:
    unset = {name: value for name, value in os.environ.items() if name not in CHOICE}
    program = f"import {package}\nimport numpy\n{ENABLED.format(_newer())}"
    run = subprocess.run([sys.executable, "-c", program], env=unset, capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["True", "False"]


def _newer() -> str:
    """The name that the installed numpy has for what comes after AVX2."""
    from numpy._core._multiarray_umath import __cpu_dispatch__ as dispatched  # type: ignore[import-not-found]

    return next(name for name in CHOICE["NPY_DISABLE_CPU_FEATURES"].split() if name in dispatched)
