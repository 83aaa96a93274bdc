"""Faster construction of frozen dataclasses, of which a step makes hundreds."""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Any, TypeVar

C = TypeVar("C", bound=type[Any])


def quickly_made(frozen: C) -> C:
    """Class decorator: construct objects of a frozen dataclass like those of a mutable one.

    The `__init__` of a frozen dataclass sets each field through `object.__setattr__`, which takes several times as
    long. Assignments to fields are not refused at run time any more, only by mypy. The class must not have a
    `__post_init__`.
    """
    known: dict[str, Any] = {"MISSING": MISSING}
    parameters, lines = ["self"], []
    for each in fields(frozen):
        name, made, default = each.name, each.name, ""
        if each.default_factory is not MISSING:
            known[f"make_{name}"], default = each.default_factory, "=MISSING"
            made = f"make_{name}() if {name} is MISSING else {name}"
        elif each.default is not MISSING:
            known[f"default_{name}"], default = each.default, f"=default_{name}"
        parameters.append(name + default)
        lines.append(f"    self.{name} = {made}\n")
    exec(f"def __init__({', '.join(parameters)}):\n{''.join(lines)}", known)  # noqa: S102 - as dataclasses does it
    frozen.__init__ = known["__init__"]
    del frozen.__setattr__, frozen.__delattr__
    return frozen
