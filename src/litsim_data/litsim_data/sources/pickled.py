"""Plain data in pickles, read without executing anything: numbers, texts, lists, dicts and arrays of numbers.

A pickle is a program for a machine with a stack, which may call any function of Python. This machine knows only the
instructions that build plain data, and calls nothing that a file names: whatever else is made in a file becomes
:class:`Opaque`.
"""

from __future__ import annotations

import pickletools
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from litsim_sim.core.checks import CELLS_MAX, check_budget
from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import TREE_MAX, open_input

TYPE = r"[<>|=]?[biufSU]\d+"
"""Pattern of numpy's codes of elements of arrays that are truth values, numbers or texts."""
DICTS = ("defaultdict", "OrderedDict", "ScenarioDescription")
"""Classes that are dicts, whatever their package."""
ARRAYS = ("numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric", "numpy._core.numeric")
OPERATIONS_MAX = 2_000_000  # instructions of a file; a scenario has 30 000
LEVELS_MAX = 50  # of lists within lists
MARK = object()


class Opaque:
    """Something that is no plain data."""


@dataclass(frozen=True)
class _Name:
    """A function or class that a file names, which is not looked up."""

    module: str
    name: str


class _Array:
    """An array, empty until its state is set."""

    value: np.ndarray | Opaque = Opaque()


class _Type:
    """A type of elements, whose order of bytes its state sets."""

    def __init__(self, code: str) -> None:
        self.value = np.dtype(code)


def read_pickle(path: Path) -> Any:
    """Returns the plain data in a file, of at most TREE_MAX bytes.

    Raises:
        InputError: it cannot be read, is no pickle, or an array does not fit its bytes.
    """
    try:
        with open_input(path, size_max=TREE_MAX) as file:
            return _Machine().run(file.read())
    except (ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError, MemoryError) as error:
        raise InputError(f"{path}: not a readable pickle: {type(error).__name__} {error}") from error


class _Machine:
    """The machine, whose `stack` holds what is under construction, and `memo` what is used again."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}

    def run(self, content: bytes) -> Any:
        """Returns what the instructions in `content` build; raises ValueError, IndexError or KeyError."""
        argument: Any
        for number, (operation, argument, _) in enumerate(pickletools.genops(content)):
            check_budget("instructions", number, OPERATIONS_MAX)
            name = operation.name
            if name == "STOP":
                whole = plain(self.stack.pop())
                _count(whole)
                return whole
            if name in CONSTANTS:
                self.stack.append(CONSTANTS[name])
            elif name in MADE:
                self.stack.append(MADE[name]())
            elif name in GIVEN:
                self.stack.append(argument)
            elif name in IGNORED:
                continue
            elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
                self.memo[int(argument)] = self.stack[-1]
            elif name == "MEMOIZE":
                self.memo[len(self.memo)] = self.stack[-1]
            elif name in ("GET", "BINGET", "LONG_BINGET"):
                self.stack.append(self.memo[int(argument)])
            else:
                step = STEPS.get(name)
                if step is None:
                    raise ValueError(f"instruction {name}, which plain data do not need")
                step(self, argument)
        raise ValueError("it ends before its last instruction")

    def since_mark(self) -> list[Any]:
        """Takes what lies above the last mark, and the mark, from the stack, and returns it."""
        begin = len(self.stack) - 1
        while self.stack[begin] is not MARK:
            begin -= 1
            if begin < 0:
                raise ValueError("a mark is missing")
        taken = self.stack[begin + 1 :]
        del self.stack[begin:]
        return taken

    def take(self, count: int) -> list[Any]:
        """Takes the last `count` from the stack, and returns them in their order."""
        if len(self.stack) < count:
            raise ValueError("the stack is empty")
        taken = self.stack[-count:]
        del self.stack[-count:]
        return taken

    def tuple_of(self, count: int | None) -> None:
        """Makes a tuple of the last `count`; None for all since the mark."""
        self.stack.append(tuple(map(plain, self.since_mark() if count is None else self.take(count))))

    def extend(self, values: list[Any]) -> None:
        """Adds `values` to the list or set that is last."""
        last = self.stack[-1]
        if isinstance(last, list):
            last.extend(map(plain, values))
        elif not isinstance(last, Opaque):
            raise TypeError(f"{type(last).__name__} is no list")

    def set_items(self, pairs: list[Any]) -> None:
        """Sets items of the dict that is last: a key, its value, and so on."""
        last = self.stack[-1]
        if isinstance(last, Opaque):
            return
        if not isinstance(last, dict):
            raise TypeError(f"{type(last).__name__} is no dict")
        for key, value in zip(pairs[::2], pairs[1::2], strict=True):
            if isinstance(key, str | int | float):  # others nobody looks up
                last[key] = plain(value)

    def list_of(self, values: list[Any]) -> None:
        """Makes a list."""
        self.stack.append([*map(plain, values)])

    def dict_of(self, pairs: list[Any]) -> None:
        """Makes a dict of a key, its value, and so on."""
        self.stack.append({})
        self.set_items(pairs)

    def named(self, argument: str | None) -> None:
        """Puts a name of a module onto the stack, of the `argument` or of the last two texts."""
        module, name = self.take(2) if argument is None else argument.split(" ", 1)
        if not (isinstance(module, str) and isinstance(name, str)):
            raise TypeError("the name of a module is no text")
        self.stack.append(_Name(module, name))

    def call(self) -> None:
        """Puts the result of a known function onto the stack in place of its name and arguments."""
        function, arguments = self.take(2)
        self.stack.append(_result(function, arguments))

    def set_state(self) -> None:
        """Sets the state of an array or of a type, as numpy writes it; that of others is not used."""
        state = self.stack.pop()
        last = self.stack[-1]
        if isinstance(last, _Type) and isinstance(state, tuple):
            last.value = last.value.newbyteorder(state[1]) if state[1] in ("<", ">") else last.value
        elif isinstance(last, _Array) and isinstance(state, tuple):
            _, shape, kind, fortran, content = state
            last.value = _array(content, kind, shape, "F" if fortran else "C")


def plain(value: Any) -> Any:
    """Returns an array or a type as what it is, and what else is given as it is."""
    return value.value if isinstance(value, _Array | _Type) else value


def _count(content: Any, level: int = 0, count: int = 0) -> int:
    """Returns `count` and the number of parts of `content`, where one that is used again counts again.

    Raises:
        ValueError: they are too many, or are within each other: few instructions can demand any number.
    """
    check_budget("levels of lists within lists", level, LEVELS_MAX)
    parts = content.values() if isinstance(content, dict) else content if isinstance(content, list | tuple) else ()
    count += len(parts)
    check_budget("parts", count, OPERATIONS_MAX)
    for part in parts:
        if isinstance(part, list | tuple | dict):
            count = _count(part, level + 1, count)
        elif isinstance(part, np.ndarray):
            count += part.size * OPERATIONS_MAX // CELLS_MAX
    return count


def _result(function: Any, arguments: Any) -> Any:
    """Returns what a function that a file names makes of `arguments`, if it makes plain data; else Opaque."""
    if not isinstance(function, _Name) or not isinstance(arguments, tuple):
        return Opaque()
    if function.name in DICTS:
        return {}
    package = "numpy" if function.module in ARRAYS else function.module
    make = FUNCTIONS.get((package, function.name))
    return Opaque() if make is None else make(*arguments)


def _filled(content: Any, kind: Any, shape: Any, order: str = "C") -> _Array:
    """Returns an array that needs no state."""
    made = _Array()
    made.value = _array(content, kind, shape, order)
    return made


def _scalar(kind: Any, content: Any = None) -> Any:
    """Returns one number or text."""
    value = _array(content, kind, (), "C")
    return value.item() if isinstance(value, np.ndarray) else value


def _type(code: Any, *_: Any) -> _Type | Opaque:
    """Returns the type of elements with a code of numpy, if they are numbers or texts."""
    return _Type(code) if isinstance(code, str) and re.fullmatch(TYPE, code) else Opaque()


def _array(content: Any, kind: Any, shape: Any, order: str) -> np.ndarray | Opaque:
    """Returns the array of a `shape` whose elements are in `content`, if they are numbers or texts; else Opaque."""
    if not isinstance(kind, np.dtype) or not isinstance(content, bytes | bytearray):
        return Opaque()
    if not all(isinstance(length, int) and length >= 0 for length in shape):
        raise ValueError("the shape of an array is not of lengths")
    flat = np.frombuffer(content, kind) if content else np.zeros(0, kind)
    return flat.reshape(tuple(shape), order="F" if order == "F" else "C")


FUNCTIONS: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "_reconstruct"): lambda *_: _Array(),
    ("numpy", "_frombuffer"): _filled,
    ("numpy", "scalar"): _scalar,
    ("numpy", "dtype"): _type,
    ("_codecs", "encode"): lambda text, *_: str.encode(text, "latin-1"),  # bytes, before protocol 3
    ("__builtin__", "bytes"): lambda *_: b"",  # likewise, of which there are none
}
"""What functions that files name make, by package and name."""
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "MARK": MARK, "EMPTY_TUPLE": ()}
MADE: dict[str, Callable[[], Any]] = {"EMPTY_DICT": dict, "EMPTY_LIST": list, "EMPTY_SET": Opaque}
GIVEN = (
    *("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "INT", "LONG", "FLOAT"),
    *("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "UNICODE", "STRING", "BINSTRING", "SHORT_BINSTRING"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
)
"""Instructions that put their argument onto the stack."""
IGNORED = ("PROTO", "FRAME")
STEPS: dict[str, Callable[[_Machine, Any], object]] = {
    "TUPLE": lambda machine, _: machine.tuple_of(None),
    "TUPLE1": lambda machine, _: machine.tuple_of(1),
    "TUPLE2": lambda machine, _: machine.tuple_of(2),
    "TUPLE3": lambda machine, _: machine.tuple_of(3),
    "LIST": lambda machine, _: machine.list_of(machine.since_mark()),
    "APPEND": lambda machine, _: machine.extend(machine.take(1)),
    "APPENDS": lambda machine, _: machine.extend(machine.since_mark()),
    "ADDITEMS": lambda machine, _: machine.extend(machine.since_mark()),
    "FROZENSET": lambda machine, _: machine.tuple_of(None),
    "DICT": lambda machine, _: machine.dict_of(machine.since_mark()),
    "SETITEM": lambda machine, _: machine.set_items(machine.take(2)),
    "SETITEMS": lambda machine, _: machine.set_items(machine.since_mark()),
    "GLOBAL": lambda machine, argument: machine.named(argument),
    "STACK_GLOBAL": lambda machine, _: machine.named(None),
    "REDUCE": lambda machine, _: machine.call(),
    "NEWOBJ": lambda machine, _: machine.call(),
    "BUILD": lambda machine, _: machine.set_state(),
    "POP": lambda machine, _: machine.take(1),
}
"""Instructions that build of what is on the stack."""
