"""Plain data in pickles, read without executing anything: numbers, texts, lists, dicts and arrays of numbers.

A pickle is a program, which may call any function of Python that it names. Here no name is looked up: those by which
plain data are built stand for functions of this module, and whatever else is made in a file becomes :class:`Opaque`.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from litsim_sim.core.checks import CELLS_MAX, check_budget
from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import TREE_MAX, open_input

TYPE = r"[<>|=]?[biufSU]\d+"
"""Pattern of numpy's codes of elements of arrays that are truth values, numbers or texts."""
DICTS = ("defaultdict", "OrderedDict", "ScenarioDescription")
"""Classes that are dicts, whatever their package."""
ARRAYS = ("numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric", "numpy._core.numeric")
OPERATIONS_MAX = 2_000_000  # instructions of a file, and places that they remember; a scenario has 30 000
LEVELS_MAX = 50  # of lists within lists
UNREADABLE = (pickle.UnpicklingError, ValueError, TypeError, LookupError, AttributeError, OverflowError, MemoryError)


class Opaque:
    """Something that is no plain data, which takes whatever a file does to it."""

    def __new__(cls, *_: Any) -> Self:
        """Returns one, whatever it is to be made of."""
        return super().__new__(cls)

    def __init__(self, *_: Any) -> None: ...

    def __call__(self, *_: Any) -> Opaque:
        """Returns another one."""
        return Opaque()

    def __setstate__(*_: Any) -> None: ...

    def __setitem__(*_: Any) -> None: ...

    append = extend = __setitem__


class _Dict(dict[Any, Any]):
    """A dict, whatever it is to be made of."""

    def __init__(self, *_: Any) -> None: ...

    def __setstate__(*_: Any) -> None: ...


class _Array:
    """An array, empty until its state is set, as numpy writes it."""

    value: np.ndarray | Opaque = Opaque()

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, kind, fortran, content = state
        self.value = _array(content, kind, shape, "F" if fortran else "C")


class _Type:
    """A type of elements, whose order of bytes its state sets."""

    def __init__(self, code: str) -> None:
        self.value = np.dtype(code)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.value = self.value.newbyteorder(state[1]) if state[1] in ("<", ">") else self.value


class _Unpickler(pickle.Unpickler):
    """Builds plain data."""

    def find_class(self, module: str, name: str) -> Any:
        """Returns what stands for a name of a module; nothing that the file does to it outlives the file."""
        if name in DICTS:
            return _Dict
        make = FUNCTIONS.get(("numpy" if module in ARRAYS else module, name))
        return Opaque if make is None else partial(make)


def read_pickle(path: Path) -> Any:
    """Returns the plain data in a file, of at most TREE_MAX bytes.

    Raises:
        InputError: it cannot be read, is no pickle, or an array does not fit its bytes.
    """
    try:
        with open_input(path, size_max=TREE_MAX) as file:
            content = file.read()
        for number, (operation, argument, _) in enumerate(pickletools.genops(content)):
            check_budget("instructions", number, OPERATIONS_MAX)
            if "PUT" in operation.name:
                check_budget("place to remember", int(argument or 0), OPERATIONS_MAX)
        return _plain(_Unpickler(io.BytesIO(content)).load(), 0, [0])
    except UNREADABLE as error:
        raise InputError(f"{path}: not a readable pickle: {type(error).__name__} {error}") from error


def _plain(value: Any, level: int, parts: list[int]) -> Any:
    """Returns a value with arrays and types in place of what stands for them.

    Raises:
        ValueError: its `parts`, which are counted where one is used again as well, are too many, or within each other:
            few instructions can demand any number.
    """
    check_budget("levels of lists within lists", level, LEVELS_MAX)
    value = value.value if isinstance(value, _Array | _Type) else value
    if isinstance(value, np.ndarray):
        parts[0] += value.size * OPERATIONS_MAX // CELLS_MAX
    if not isinstance(value, dict | list | tuple):
        return value
    parts[0] += len(value)
    check_budget("parts", parts[0], OPERATIONS_MAX)
    if isinstance(value, dict):  # keys of other kinds nobody looks up
        plain = {key: part for key, part in value.items() if isinstance(key, str | int | float)}
        return {key: _plain(part, level + 1, parts) for key, part in plain.items()}
    return type(value)(_plain(part, level + 1, parts) for part in value)


def _scalar(kind: Any, content: Any = None) -> Any:
    """Returns one number or text."""
    value = _array(content, kind, ())
    return value.item() if isinstance(value, np.ndarray) else value


def _type(code: Any, *_: Any) -> _Type | Opaque:
    """Returns the type of elements with a code of numpy, if they are numbers or texts."""
    return _Type(code) if isinstance(code, str) and re.fullmatch(TYPE, code) else Opaque()


def _array(content: Any, kind: Any, shape: Any, order: str = "C") -> np.ndarray | Opaque:
    """Returns the array of a `shape` whose elements are in `content`, if they are numbers or texts; else Opaque."""
    if not isinstance(kind, _Type) or not isinstance(content, bytes | bytearray):
        return Opaque()
    if not all(isinstance(length, int) and length >= 0 for length in shape):
        raise ValueError("the shape of an array is not of lengths")
    flat = np.frombuffer(content, kind.value) if content else np.zeros(0, kind.value)
    return flat.reshape(tuple(shape), order="F" if order == "F" else "C")


FUNCTIONS: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "_reconstruct"): lambda *_: _Array(),
    ("numpy", "_frombuffer"): _array,
    ("numpy", "scalar"): _scalar,
    ("numpy", "dtype"): _type,
    ("_codecs", "encode"): lambda text, *_: str.encode(text, "latin-1"),  # bytes, before protocol 3
    ("__builtin__", "bytes"): lambda *_: b"",  # likewise, of which there are none
}
"""What functions that files name make, by package and name."""
