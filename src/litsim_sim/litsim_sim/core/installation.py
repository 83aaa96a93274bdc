"""How LitSim is installed here, and what people type there: in a workspace ./litsim and make, by pip litsim and pip."""

from __future__ import annotations

import os
import re
from importlib import metadata
from importlib.util import find_spec

PIP_PACKAGE = "litsim-ros"
"""What an installation by pip is called: all packages in one (pyproject.toml)."""


def command() -> str:
    """Returns how LitSim is called here: as it was typed, where its script tells so."""
    return os.environ.get("LITSIM") or ("./litsim" if _requirements() is None else "litsim")


def installs(package: str) -> str:
    """Returns the command that installs an optional `package` here; by pip, with all of what it is needed for."""
    requirements = _requirements()
    if requirements is None:
        return "make setup-all"
    pattern = re.compile(rf"{re.escape(package)}\b.*; extra == [\"'](\w+)")
    extras = [found[1] for requirement in requirements if (found := pattern.match(requirement))]
    return f"pip install '{PIP_PACKAGE}[{extras[0]}]'" if extras else f"pip install {package}"


def has_ros() -> bool:
    """Returns whether nodes can be started here."""
    try:
        return find_spec("rclpy") is not None
    except ModuleNotFoundError:  # by an import hook that refuses it
        return False


def _requirements() -> list[str] | None:
    """Returns what an installation by pip requires; None in a workspace."""
    try:
        return metadata.requires(PIP_PACKAGE) or []
    except metadata.PackageNotFoundError:
        return None
