"""Where the executables of the workspace are: the files that ``ros2 run PACKAGE EXECUTABLE`` starts."""

from __future__ import annotations

from pathlib import Path

from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.stages import EGO, POLICY

STAGES_PROGRAM = "stages"
"""Executable of several stages in one process, in the package of the policy's stage; its arguments are their names."""


def find_executable(package: str, executable: str) -> Path:
    """The file of `executable` of `package`, whichever way the packages depend on each other.

    Raises:
        InputError: the package is not built, not sourced, or has no such executable.
        ModuleNotFoundError: there is no ROS.
    """
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix  # campaigns need it over DDS only

    try:
        path = Path(get_package_prefix(package)) / "lib" / package / executable
    except PackageNotFoundError as error:
        raise InputError(f"package {package} is not built or not sourced: {error}") from error
    if not path.is_file():
        raise InputError(f"{path}: no such executable; build the workspace (make build)")
    return path


def program_of(stage: str) -> tuple[str, str]:
    """Package and executable of the node of a stage: of the package that registers the stage, with the stage's name.

    The ego's node is that of the policy's package, whichever plug-in drives.

    Raises:
        InputError: no installed package has the stage.
    """
    return plugins.package_of(plugins.STAGES, POLICY if stage == EGO else stage), stage


def stages_program() -> tuple[str, str]:
    """Package and executable of several stages in one process.

    Raises:
        InputError: no installed package has the policy's stage.
    """
    return plugins.package_of(plugins.STAGES, POLICY), STAGES_PROGRAM
