"""Docstrings for the reference of the site: the few marks of reStructuredText in them become those of Markdown."""

from __future__ import annotations

import re
from typing import Any

import griffe

ROLE = re.compile(r":\w+:`(~?)\.?([\w.]+)`")
CODE_FOLLOWS = re.compile(r"::$", re.MULTILINE)


def markdown(text: str) -> str:
    """Returns a docstring with roles as code, by the last part of a name behind ``~``, and `::` as a colon."""
    plain = ROLE.sub(lambda role: f"`{role[2].rpartition('.')[2] if role[1] else role[2]}`", text)
    return CODE_FOLLOWS.sub(":", plain)


class Docstrings(griffe.Extension):
    """Rewrites the docstrings that griffe has read."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrites that of one object."""
        if obj.docstring is not None:
            obj.docstring.value = markdown(obj.docstring.value)
