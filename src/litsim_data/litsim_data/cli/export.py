"""`data export`: a run, a scenario, a recording or a net in the format of another tool."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from litsim_sim.io.files import refuse_input_as_output


def add(subparsers: Any) -> None:
    """Adds the parser of the command."""
    command = subparsers.add_parser(
        "export",
        help="a run, a scenario, a recording or a net in the format of another tool",
        description="Export what happens in a run, a scenario or a recording, or a net. The ending of OUT names the "
        "format; one that is not known lists them all.",
    )
    command.add_argument(
        "source",
        type=Path,
        metavar="IN",
        help="folder or MCAP file of a run, name or file of a scenario or net, or a recording of any known format",
    )
    command.add_argument("out", type=Path, metavar="OUT", help="the file to write; some formats need others beside it")
    command.add_argument("--net", metavar="NET", help="net of a recording, packaged or a file; default: its header's")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Exports, and prints what.

    Raises:
        InputError: IN cannot be used, lacks what the format needs, or OUT cannot be written.
    """
    from litsim_data.exports.export import format_of
    from litsim_data.exports.reading import opened

    file_format = format_of(arguments.out)
    refuse_input_as_output(arguments.out, arguments.source)
    with opened(arguments.source, arguments.net) as content:
        lines = file_format.write(content, arguments.out)
    print(": ".join([str(arguments.out), *lines[:1]]), *lines[1:], sep="\n")
