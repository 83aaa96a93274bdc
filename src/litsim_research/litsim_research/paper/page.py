"""Generated parts of docs/results.md, between marks; the rest is written by hand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import write_text
from litsim_sim.io.yaml_input import read_text

END = "<!-- end: figures -->"


def begin(command: str) -> str:
    """Returns the line before the part that `command` writes, without inputs and digest of tools/figures.py."""
    return f"<!-- begin: figures {command} -->"


def fill(path: Path, command: str, lines: Sequence[str]) -> None:
    """Put `lines` between the marks of `command` in the file `path`; the mark that begins the part stays as it is.

    Raises:
        InputError: the file cannot be read or written, or lacks the marks.
    """
    text = read_text(path)
    marked = re.compile(rf"(<!-- begin: figures {re.escape(command)}(?:;[^>]*)? -->\n).*?{re.escape(END)}", re.DOTALL)
    if not marked.search(text):
        raise InputError(f"{path}: expected lines {begin(command)} and {END} around the results")
    content = "".join(f"{line}\n" for line in lines)
    write_text(path, marked.sub(lambda match: f"{match[1]}{content}{END}", text, count=1))
