"""Every package that the set-up installs is one that was tried, to the byte."""

import re
from pathlib import Path

import pytest
from packaging.requirements import Requirement

FOLDER = Path(__file__).resolve().parents[2] / "requirements"
MADE_FROM = {"base": ("ros", "run", "build"), "dev": ("dev", "export"), "torch-cpu": ("torch",)}
"""What a file of locked packages was made from, where that is not one file of its name."""
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}\b")


def plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def locked(name: str) -> dict[str, tuple[Requirement, int]]:
    """Packages of a locked file: what is asked for, and how many hashes it may have."""
    text = (FOLDER / f"locked/{name}.txt").read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.lstrip().startswith("#")]
    found = [(Requirement(line.partition("--hash")[0]), len(HASH.findall(line))) for line in lines]
    return {plain(requirement.name): (requirement, hashes) for requirement, hashes in found}


def asked_for(file: str) -> list[Requirement]:
    lines = [line.partition("#")[0].strip() for line in (FOLDER / f"{file}.txt").read_text().splitlines()]
    return [Requirement(line) for line in lines if line]


NAMES = sorted(path.stem for path in (FOLDER / "locked").glob("*.txt"))


def test_all_are_locked() -> None:
    files = {path.stem for path in FOLDER.glob("*.txt")} - {"constraints"}
    assert {file for name in NAMES for file in MADE_FROM.get(name, (name,))} == files


@pytest.mark.parametrize("name", NAMES)
def test_every_package_is_pinned_with_hashes(name: str) -> None:
    for package, (requirement, hashes) in locked(name).items():
        assert [each.operator for each in requirement.specifier] == ["=="], package
        assert hashes > 0, package


@pytest.mark.parametrize("name", NAMES)
def test_what_is_asked_for_is_locked_in_a_version_that_fits(name: str) -> None:
    packages = locked(name)
    for file in MADE_FROM.get(name, (name,)):
        for wanted in asked_for(file):
            (pin,) = packages[plain(wanted.name)][0].specifier
            assert wanted.specifier.contains(pin.version), f"{wanted}: make lock"


@pytest.mark.parametrize("name", NAMES)
def test_versions_are_those_of_the_constraints(name: str) -> None:
    tried = {plain(each.name): str(each.specifier) for each in asked_for("constraints")}
    differ = {
        package: (str(requirement.specifier), tried[package])
        for package, (requirement, _) in locked(name).items()
        if tried.get(package, str(requirement.specifier)) != str(requirement.specifier)
    }
    assert not differ, "make lock"


def test_the_cpu_build_of_torch_has_a_hash_for_each_python_and_nothing_for_gpus() -> None:
    packages = locked("torch-cpu")
    torch, hashes = packages["torch"]
    assert str(torch.specifier).endswith("+cpu")
    assert hashes == 2  # CPython 3.11 and 3.12
    assert not [name for name in packages if name.startswith(("nvidia-", "cuda-", "triton"))]
