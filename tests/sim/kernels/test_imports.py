"""Imports that libraries make just in case are left out where they take long."""

import importlib
import subprocess
import sys

import pytest

from litsim_sim.kernels.imports import left_out

PREPARED = """
import sys
from litsim_sim.nodes.shared import prepare_nodes
prepare_nodes()
print(sorted({"coverage", "scipy"} & set(sys.modules)))
"""


def test_what_is_left_out_fails_meanwhile_and_not_afterwards() -> None:
    with left_out("tabnanny"), pytest.raises(ImportError):
        importlib.import_module("tabnanny")
    assert importlib.import_module("tabnanny").__name__ == "tabnanny"


def test_what_is_there_already_stays() -> None:
    with left_out("subprocess"):
        assert importlib.import_module("subprocess") is subprocess


def test_a_launcher_imports_neither_coverage_nor_scipy() -> None:
    run = subprocess.run([sys.executable, "-c", PREPARED], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
