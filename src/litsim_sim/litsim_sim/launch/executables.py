"""Where the executables of the workspace are: the files that ``ros2 run PACKAGE EXECUTABLE`` starts."""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from litsim_sim.core.errors import InputError
from litsim_sim.core.stage_registry import registered_name
from litsim_sim.core.stages import BRIDGE, CONFLICT, EGO, POLICY, PREDICTOR, RECORDER

EXECUTABLES = {
    RECORDER: ("litsim_sim", "recorder"),
    PREDICTOR: ("litsim_predictor", "predictor"),
    CONFLICT: ("litsim_policy", "conflict"),
    POLICY: ("litsim_policy", "policy"),
    BRIDGE: ("litsim_sim", "bridge"),
}
"""Package and executable of every node but the ego."""
STAGES_PROGRAM = ("litsim_policy", "stages")
"""Package and executable of several stages in one process; its arguments are the executables of each on its own."""


def find_executable(package: str, executable: str) -> Path:
    """The file of `executable` of `package`, whichever way the packages depend on each other.

    Raises:
        InputError: the package is not built, not sourced, or has no such executable.
    """
    try:
        path = Path(get_package_prefix(package)) / "lib" / package / executable
    except PackageNotFoundError as error:
        raise InputError(f"package {package} is not built or not sourced: {error}") from error
    if not path.is_file():
        raise InputError(f"{path}: no such executable; build the workspace (make build)")
    return path


def program_of(node: str, ego: str) -> tuple[str, str]:
    """Package and executable of a node of the graph by the name of its stage; of the stage `ego`, by its driver."""
    return ("litsim_policy", registered_name(node, ego)) if node == EGO else EXECUTABLES[node]


def node_executable(node: str, ego: str) -> Path:
    """The file of :func:`program_of`.

    Raises:
        InputError: there is none.
    """
    return find_executable(*program_of(node, ego))
