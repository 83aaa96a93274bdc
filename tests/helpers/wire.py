"""Malformed ROS messages, as from a faulty or foreign node: valid ones with one wrong field."""

import copy
from array import array
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

ODD = [float("nan"), float("inf"), float("-inf"), 1e300, -1e300, 0.0, -1.0]
TEXTS = st.text(max_size=20) | st.sampled_from(["", "another run", "short-idm-litsim-13-0@1", "\0", "x" * 10_000])
WAYS = ("empty", "shorter", "longer", "one wrong", "one twice", "turned round")


@st.composite
def damaged(draw: st.DrawFn, message: Any) -> Any:
    """A copy of `message` with one field, or one of a nested message, changed; the result may be valid."""
    made = copy.deepcopy(message)
    _damage(draw, made)
    return made


def _damage(draw: st.DrawFn, message: Any) -> None:
    name = draw(st.sampled_from(sorted(message.get_fields_and_field_types())))
    value = getattr(message, name)
    if hasattr(value, "get_fields_and_field_types"):
        _damage(draw, value)
    elif isinstance(value, array | list):
        if len(value) and hasattr(value[0], "get_fields_and_field_types") and draw(st.booleans()):
            _damage(draw, value[draw(st.integers(0, len(value) - 1))])
        else:
            setattr(message, name, _sequence(draw, value))
    else:
        setattr(message, name, _scalar(draw, message.get_fields_and_field_types()[name], value))


def _scalar(draw: st.DrawFn, kind: str, value: Any) -> Any:
    if kind in ("double", "float"):
        return draw(st.sampled_from(ODD) | st.floats())
    if kind == "boolean":
        return not value
    if kind == "string":
        return draw(TEXTS)
    bits = int(kind.removeprefix("u").removeprefix("int"))
    low, high = (0, 2**bits) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1))
    return draw(st.sampled_from([low, high - 1]) | st.integers(low, high - 1))


def _sequence(draw: st.DrawFn, value: Any) -> Any:
    items = list(value)
    way = draw(st.sampled_from(WAYS))
    if way == "longer":
        items = items + (items[-1:] or ([] if not isinstance(value, array) else [0])) * draw(st.integers(1, 3))
    elif items and way == "one wrong" and isinstance(value, array):
        at = draw(st.integers(0, len(items) - 1))
        items[at] = draw(st.sampled_from(ODD)) if value.typecode in "df" else draw(st.integers(0, 127))
        if value.typecode == "f" and abs(items[at]) == 1e300:
            items[at] = float("inf")
    elif items and way == "one twice":
        items[-1] = items[0]
    elif way == "turned round":
        items.reverse()
    elif way == "shorter":
        items = items[: draw(st.integers(0, max(0, len(items) - 1)))]
    elif way == "empty":
        items = []
    return array(value.typecode, items) if isinstance(value, array) else items


def taken(take: Callable[[Any], Any], message: Any, refused: type[Exception], where: str = "") -> Any:
    """The result of `take` for `message`; None if it is refused, in one line that begins with `where`."""
    try:
        return take(message)
    except refused as error:
        said = str(error)
    assert said.startswith(where) and "\n" not in said
    return None
