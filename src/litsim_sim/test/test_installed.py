"""What `colcon test` proves of this package where it was built: each of its executables starts."""

import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

PACKAGE = Path(__file__).parents[1].name
EXECUTABLES = sorted((Path(get_package_prefix(PACKAGE)) / "lib" / PACKAGE).iterdir())


@pytest.mark.parametrize("executable", EXECUTABLES, ids=lambda path: path.name)
def test_every_executable_says_how_it_is_used(executable: Path) -> None:
    shown = subprocess.run([executable, "--help"], capture_output=True, text=True, check=False)
    assert shown.returncode == 0, shown.stderr
    assert shown.stdout.lower().startswith("usage")
