"""`litsim VERB`: the command of an installation by pip, without ROS; a workspace has the script `./litsim` for it."""

from __future__ import annotations

import sys
from importlib.metadata import version
from importlib.resources import files

from litsim_sim.cli.program import program
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError, without_ros
from litsim_sim.core.installation import PIP_PACKAGE, has_ros

USAGE = """\
Usage: litsim VERB [ARGUMENTS...]        litsim VERB --help says more
       litsim --version

"""
OF_ROS = "(ROS 2)"
"""End of the description of a verb that does nothing without ROS."""


@program
def main() -> int | None:
    """Entry point of the command `litsim`."""
    verb, *arguments = sys.argv[1:] or ["--help"]
    described = files(__package__).joinpath("verbs.txt").read_text(encoding="utf-8").splitlines()
    if verb in ("-h", "--help"):
        print(USAGE + "\n".join(f"  {line}" for line in described))
        return None
    if verb == "--version":
        print(f"litsim {version(PIP_PACKAGE)}")
        return None
    entry = plugins.installed(plugins.VERBS).get(verb)
    if entry is None:
        raise InputError(f"no verb {verb!r}; there are: {' '.join(line.split()[0] for line in described)}")
    if any(line.startswith(f"{verb} ") and line.endswith(OF_ROS) for line in described) and not has_ros():
        raise without_ros("rclpy")
    sys.argv = [verb, *arguments]
    status: int | None = entry.load()()
    return status
