"""`data`: look at recordings, convert and generate them, build nets, draw and export.

Every module of this package whose name has no leading underscore is a sub-command of that name, with two functions:

- ``add(subparsers) -> None`` adds the parser of the command and sets its default ``run``;
- ``run(arguments) -> int | None`` does the work, returns the exit status or None for 0, and raises
  :class:`litsim_sim.core.errors.InputError` where the input cannot be used.
"""

from __future__ import annotations

import importlib
import pkgutil

from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program


@program
def main(
    argv: list[str] | None = None,
) -> int | None:  # `list` is no module: those are imported by name
    """Entry point of ``ros2 run litsim_data data``."""
    parser = Parser(prog="data", description=(__doc__ or "").split("\n", maxsplit=1)[0])
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name in sorted(module.name for module in pkgutil.iter_modules(__path__)):
        if not name.startswith("_"):
            importlib.import_module(f"{__name__}.{name}").add(subparsers)
    arguments = parser.parse_args(argv)
    status: int | None = arguments.run(arguments)
    return status
