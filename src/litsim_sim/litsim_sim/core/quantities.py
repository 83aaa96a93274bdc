"""Types of the fields of configurations, with bounds and units.

A configuration is a frozen dataclass whose fields have these types, as in ``duration: Positive[Duration]``. Pydantic
checks them once, when the configuration is made. An integer is accepted for a number and a list for a tuple; nothing
else is converted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from types import NoneType
from typing import Annotated, Any, Literal, TypeVar, dataclass_transform, get_args, get_origin

import pydantic.dataclasses
from pydantic import ConfigDict, Field, Strict
from pydantic.fields import FieldInfo
from pydantic_core.core_schema import CoreSchema, no_info_after_validator_function, str_schema

from litsim_sim.core.scene import STEP_S

_T = TypeVar("_T")


@dataclasses.dataclass(frozen=True)
class Unit:
    """Annotation of a type with the unit of the field."""

    symbol: str


@dataclasses.dataclass(frozen=True)
class OneOf:
    """Annotation of a text type with its possible values, or a function that gives them, as of installed plug-ins."""

    values: tuple[str, ...] | Callable[[], tuple[str, ...]]

    @property
    def allowed(self) -> tuple[str, ...]:
        """The possible values now."""
        return self.values() if callable(self.values) else self.values

    def __get_pydantic_core_schema__(self, source: Any, handler: pydantic.GetCoreSchemaHandler) -> CoreSchema:
        """Pydantic's schema of the type: exactly one of the values."""
        return no_info_after_validator_function(self._check, str_schema(strict=True))

    def _check(self, value: str) -> str:
        if value not in self.allowed:
            raise ValueError(f"expected one of {', '.join(self.allowed)}")
        return value


Flag = Annotated[bool, Strict()]
Number = Annotated[float, Strict(), Field(allow_inf_nan=False)]
"""A finite number without unit."""
Whole = Annotated[int, Strict()]
Steps = Annotated[Whole, Field(le=36_000), Unit("steps")]
"""Steps of the simulation, 0.1 s each; at most an hour, for which memory is there."""

Duration = Annotated[Number, Unit("s")]
Length = Annotated[Number, Unit("m")]
Speed = Annotated[Number, Unit("m/s")]
Acceleration = Annotated[Number, Unit("m/s2")]
Angle = Annotated[Number, Unit("rad")]
Curvature = Annotated[Number, Unit("1/m")]

Positive = Annotated[_T, Field(gt=0)]
NonNegative = Annotated[_T, Field(ge=0)]
Share = Annotated[Number, Field(ge=0, le=1)]
"""A probability, or a part of a whole."""
OpenShare = Annotated[Number, Field(gt=0, lt=1)]
"""A probability other than 0 and 1."""

Horizon = Annotated[Duration, Field(ge=STEP_S, le=60.0)]
"""A horizon of at least one step of the simulation; at most a minute, for which memory is there."""
ChangeTime = Annotated[Duration, Field(gt=0, le=60.0)]
"""The duration of a lane change, of at most a minute: its path has points as far as that takes."""

_KINDS = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
_BOUNDS = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field, Field))
def configuration(cls: type[_T]) -> type[_T]:
    """Class decorator: a frozen dataclass whose fields are checked against their types on construction.

    The constructor raises :class:`pydantic.ValidationError`, a ValueError, which :mod:`litsim_sim.core.parameters`
    turns into one line for users. A check of fields against each other is a ``model_validator(mode="after")`` that
    raises ValueError with a message that begins with the name of a field, such as :func:`at_most`.
    """
    checked: Any = pydantic.dataclasses.dataclass(frozen=True, config=ConfigDict(extra="forbid"))(cls)
    return checked


def at_most(config: object, field: str, bound: str) -> None:
    """Raise ValueError if a field of `config` exceeds another, its bound."""
    value, most = getattr(config, field), getattr(config, bound)
    if value > most:
        raise ValueError(f"{field} is {value!r}, expected at most {bound}, which is {most!r}")


def expected(annotation: Any) -> str:
    """Describes the values that a field of this type may have, such as ``a number of more than 0 [s]``."""
    if get_origin(annotation) is Literal:
        return f"one of {', '.join(map(str, get_args(annotation)))}"
    if get_origin(annotation) is tuple:
        parts = [part for part in get_args(annotation) if part is not Ellipsis]
        kinds = list(dict.fromkeys(map(expected, parts)))
        if len(parts) < len(get_args(annotation)):
            return f"a list, each {kinds[0]}"
        return f"a list of {len(parts)}, each {kinds[0]}" if len(kinds) == 1 else f"a list of {', then '.join(kinds)}"
    kind, notes = (get_args(annotation)[0], get_args(annotation)[1:]) if get_origin(annotation) else (annotation, ())
    notes = tuple(_flat(notes))
    for note in notes:
        if isinstance(note, OneOf):
            return f"one of {', '.join(note.allowed)}"
    bounds = [
        f"{words} {getattr(note, name):g}" for name, words in _BOUNDS.items() for note in notes if hasattr(note, name)
    ]
    units = [f" [{note.symbol}]" for note in notes if isinstance(note, Unit) and note.symbol]
    text = _KINDS.get(kind, getattr(kind, "__name__", str(kind)))
    return f"{text}{' of ' if bounds else ''}{' and '.join(bounds)}{''.join(units)}"


def unit(annotation: Any) -> str:
    """Returns the unit of a field of this type, empty for none; for a tuple that of its first item."""
    if get_origin(annotation) is tuple:
        return unit(get_args(annotation)[0])
    notes = get_args(annotation)[1:] if get_origin(annotation) is Annotated else ()
    return next((note.symbol for note in _flat(notes) if isinstance(note, Unit)), "")


def field_type(config: type, field: str) -> Any:
    """Returns the full type of a field of a :func:`configuration`, with its bounds and unit."""
    info: FieldInfo = config.__pydantic_fields__[field]  # type: ignore[attr-defined]
    return Annotated[(info.annotation or NoneType, *info.metadata)] if info.metadata else info.annotation


def _flat(notes: tuple[Any, ...]) -> Iterator[Any]:
    for note in notes:
        yield from note.metadata if isinstance(note, FieldInfo) else (note,)
