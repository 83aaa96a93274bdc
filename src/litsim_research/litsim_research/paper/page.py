"""Generated parts of docs/results.md, between marks; the rest is written by hand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing
from litsim_sim.io.yaml_input import read_text


def marks(name: str) -> tuple[str, str]:
    """The lines that enclose the generated part `name`."""
    return f"<!-- begin: paper {name} -->", f"<!-- end: paper {name} -->"


def fill(path: Path, name: str, lines: Sequence[str]) -> None:
    """Put `lines` between the marks of `name` in the file `path`.

    Raises:
        InputError: the file cannot be read or written, or lacks the marks.
    """
    begin, end = marks(name)
    text = read_text(path)
    pattern = re.compile(f"{re.escape(begin)}\n.*?{re.escape(end)}", re.DOTALL)
    if not pattern.search(text):
        raise InputError(f"{path}: expected lines {begin} and {end} around the results")
    made = "\n".join([begin, *lines, end])
    with replacing(path) as new:
        new.write_text(pattern.sub(lambda _: made, text, count=1), encoding="utf-8")
