"""The same code of numpy and OpenBLAS on every x86-64 processor with AVX2, so that equal runs have equal digests.

Both choose their code by the vector instructions that they find, and results of different code differ in their last
bits. They read these variables when numpy is imported, so the choice has to be made before.
"""

from __future__ import annotations

import sys
from collections.abc import MutableMapping
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")
BEGINNING = 8192  # bytes of it, more than the first processor takes
USED = {"avx2", "fma"}  # instructions that the chosen code needs
CHOICE = {
    # What comes after AVX2, by the names of numpy 2.4 and of earlier ones; each ignores those that it does not know.
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL",
    "OPENBLAS_CORETYPE": "Haswell",  # the first with AVX2
}


def choose_code(environment: MutableMapping[str, str], cpuinfo: Path = CPUINFO) -> None:
    """Let numba compile, and set the variables of :data:`CHOICE` where the user has not.

    The latter only if the processor has AVX2 and numpy is not loaded.
    """
    environment.pop("NUMBA_DISABLE_JIT", None)  # kernels are machine code, also where users debug code of their own
    if "numpy" not in sys.modules and _flags(cpuinfo) >= USED:
        for name, value in CHOICE.items():
            environment.setdefault(name, value)


def _flags(cpuinfo: Path) -> set[str]:
    """Instructions of the first processor that Linux lists; none elsewhere."""
    try:
        with cpuinfo.open(encoding="ascii", errors="replace") as file:
            text = file.read(BEGINNING)
    except OSError:
        return set()
    lines = (line.partition(":") for line in text.splitlines())
    return next((set(value.split()) for name, _, value in lines if name.strip() == "flags"), set())
