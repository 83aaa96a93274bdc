"""Compiled kernels: the loops of a step as machine code, by numba.

A kernel is a function of numbers and arrays, with annotations that tell numba their types::

    @kernel
    def dot(a: Floats, b: Floats) -> float: ...

An array that it writes to is annotated as one of those called ``Out...``; those that it returns are new ones. Arrays
and numbers that belong together are passed as a named tuple, the fields of which are annotated likewise::

    class Boxes(NamedTuple):
        yaw: Floats
        size: Floats2

    @kernel
    def area(boxes: Boxes, i: int) -> float: ...

A kernel is compiled for these types only. The machine code is cached on disk: only the first process on a machine
compiles (``ros2 run litsim_sim compile`` does so ahead of time); all others load the code before the first step of a
run.

Kernels compute in the order in which they are written, in one thread, without fused or reassociated operations. Equal
inputs give equal bits in every process of a machine.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
from collections.abc import Callable
from enum import Enum, EnumMeta
from functools import cache, cached_property, update_wrapper
from importlib import import_module
from inspect import get_annotations
from operator import attrgetter
from pathlib import Path
from types import FunctionType
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from litsim_sim.kernels.garbage import without_collection
from litsim_sim.kernels.imports import left_out

with left_out("coverage", "scipy"):  # where they are installed, a fifth of the time of importing numba
    import numba
from llvmlite import binding
from numba import types
from numba.core.extending import _Intrinsic as Intrinsic
from numba.core.registry import cpu_target
from numba.extending import typeof_impl

from litsim_sim.kernels import machine_code

NUMBA_ARRAYS, SCIPY_BLAS = "numba.np.arraymath", "scipy.linalg"
OPTIONS = {
    "error_model": "numpy",
    "forceinline": True,  # into calling kernels: a call costs more than most kernels
}
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T", bound=tuple[Any, ...])

KERNELS: list[Kernel] = []  # all kernels defined so far


def read_array(dtype: types.Type, ndim: int) -> types.Array:
    """Returns the type of an array that a kernel only reads; it may be read-only, and strided in one dimension."""
    return types.Array(dtype, ndim, "A" if ndim == 1 else "C", readonly=True)


def written_array(dtype: types.Type, ndim: int) -> types.Array:
    """Returns the type of a C-ordered array that a kernel writes to or returns."""
    return types.Array(dtype, ndim, "C")


float32, float64, int32, int64 = types.float32, types.float64, types.int32, types.int64
uint8, uint64 = types.uint8, types.uint64

# Types of arrays, by their elements and dimensions.
Floats = Annotated[npt.NDArray[np.float64], read_array(float64, 1)]
Floats2 = Annotated[npt.NDArray[np.float64], read_array(float64, 2)]
Floats3 = Annotated[npt.NDArray[np.float64], read_array(float64, 3)]
Singles = Annotated[npt.NDArray[np.float32], read_array(float32, 1)]
Singles2 = Annotated[npt.NDArray[np.float32], read_array(float32, 2)]
Singles3 = Annotated[npt.NDArray[np.float32], read_array(float32, 3)]
Ints = Annotated[npt.NDArray[np.int64], read_array(int64, 1)]
Ints2 = Annotated[npt.NDArray[np.int64], read_array(int64, 2)]
Bools = Annotated[npt.NDArray[np.bool_], read_array(types.boolean, 1)]
Bools2 = Annotated[npt.NDArray[np.bool_], read_array(types.boolean, 2)]
Bools3 = Annotated[npt.NDArray[np.bool_], read_array(types.boolean, 3)]
Bytes = Annotated[npt.NDArray[np.uint8], read_array(uint8, 1)]
Bytes2 = Annotated[npt.NDArray[np.uint8], read_array(uint8, 2)]
OutFloats = Annotated[npt.NDArray[np.float64], written_array(float64, 1)]
OutFloats2 = Annotated[npt.NDArray[np.float64], written_array(float64, 2)]
OutFloats3 = Annotated[npt.NDArray[np.float64], written_array(float64, 3)]
OutSingles = Annotated[npt.NDArray[np.float32], written_array(float32, 1)]
OutSingles2 = Annotated[npt.NDArray[np.float32], written_array(float32, 2)]
OutSingles3 = Annotated[npt.NDArray[np.float32], written_array(float32, 3)]
OutInts = Annotated[npt.NDArray[np.int64], written_array(int64, 1)]
OutInts2 = Annotated[npt.NDArray[np.int64], written_array(int64, 2)]
OutBytes = Annotated[npt.NDArray[np.uint8], written_array(uint8, 1)]
OutBools = Annotated[npt.NDArray[np.bool_], written_array(types.boolean, 1)]
OutBools2 = Annotated[npt.NDArray[np.bool_], written_array(types.boolean, 2)]

_PLAIN = {float: float64, int: int64, bool: types.boolean, np.float32: float32, None: types.void}


@cache
def tuple_type(named: type[tuple[Any, ...]]) -> types.BaseNamedTuple:
    """Return the type of a class of named tuples, whose fields are `float`, `int`, `bool`, arrays or such tuples.

    Kernels accept its objects if each field fits its annotation, such as :data:`Floats`, like an argument of that type.
    """
    fields = {name: numba_type(hint) for name, hint in get_type_hints(named, include_extras=True).items()}
    declared = types.BaseTuple.from_types(tuple(fields.values()), named)
    declared.name = f"{named.__name__}({', '.join(f'{name}: {field}' for name, field in fields.items())})"

    @typeof_impl.register(named)  # type: ignore[untyped-decorator]
    def type_of(value: Any, _context: object) -> Any:
        """Returns the declared type, also for writable and contiguous arrays; None if a field does not fit it."""
        fits = map(cpu_target.typing_context.can_convert, map(numba.typeof, value), fields.values())
        return None if None in fits else declared

    return declared


def tuple_of(named: type[T], source: object) -> T:
    """Return a named tuple of the attributes of `source` that have the names of its fields."""
    return cast(T, cast(Any, named)._make(attrgetter(*cast(Any, named)._fields)(source)))


def numba_type(hint: Any, *, returned: bool = False) -> types.Type:
    """Returns numba's type of what is annotated with `hint`; an array that is `returned` is a new one.

    Raises:
        TypeError: kernels know no such type.
    """
    if hint in _PLAIN:
        return _PLAIN[hint]
    if isinstance(hint, type) and issubclass(hint, tuple):
        return tuple_type(hint)
    if get_origin(hint) is tuple:
        return types.BaseTuple.from_types([numba_type(part, returned=returned) for part in get_args(hint)])
    if get_origin(hint) is not Annotated:
        raise TypeError(f"{hint} is no type of a kernel's arguments, expected a number, Floats and such, or a tuple")
    declared = get_args(hint)[1]
    return written_array(declared.dtype, declared.ndim) if returned else declared


class Kernel:
    """A compiled function; its machine code is loaded by :func:`load_kernels`, or when it is first called."""

    outer = False  # whether Python calls it, though other kernels do, too

    def __init__(self, function: FunctionType) -> None:
        update_wrapper(self, function)
        hints = get_annotations(function, eval_str=True)
        result = numba_type(hints.pop("return"), returned=True)
        self._function, self._signature = function, result(*map(numba_type, hints.values()))
        self.stamp = function.__dict__["stamp"] = _stamp(function, self._signature)
        self.uses = _kernels_of(function)

    def __call__(self, *arguments: Any) -> Any:
        """Call the machine code; arguments that do not fit the signature raise a TypeError.

        Later calls go directly to numba's dispatcher, since a function in between costs as much as a small kernel.
        Python looks up `__call__` in the class only, so each kernel gets a class of its own.
        """
        loaded = self.loaded
        self.__class__ = type(type(self).__name__, (type(self),), {"__call__": staticmethod(loaded)})
        return loaded(*arguments)

    @property
    def file(self) -> Path | None:
        """The file of its machine code, which need not exist yet; None if no cache directory is writable."""
        directory, code = cache_directory(self._source), self._function.__code__
        name = (
            f"{self._source.stem}.{self._function.__name__}-{code.co_firstlineno}-{self.stamp}"  # of this version only
        )
        return None if directory is None else directory / f"{name}.{sys.implementation.cache_tag}.kernel"

    @cached_property
    def loaded(self) -> Any:
        """Numba's dispatcher of the function, for calls; its machine code is loaded from disk, or compiled and kept."""
        file = self.file
        dispatcher = machine_code.load(file, self._function, self._signature, OPTIONS) if file else None
        if dispatcher is None:
            dispatcher = self.compiled
            if file:
                machine_code.keep(file, dispatcher, self._signature)
        return dispatcher

    @cached_property
    def compiled(self) -> Any:
        """Numba's dispatcher of the function, compiled with all that is needed to compile kernels that call it.

        Raises:
            TypeError: the function uses something that is defined after it; the cache would not notice its changes.
        """
        if _stamp(self._function, self._signature) != self.stamp:
            raise TypeError(f"kernel {self._function.__name__} uses what is defined after it")
        directory = cache_directory(self._source)
        if directory is None or not any(directory.glob(f"*-{self.stamp}.*.nbi")):
            announce()
        _leave_out_scipy()
        machine_code.box_arrays_quickly()
        before = numba.config.CACHE_LOCATOR_CLASSES
        numba.config.CACHE_LOCATOR_CLASSES = f"{__name__}.{KernelLocator.__name__}"
        try:
            return numba.njit(self._signature, cache=directory is not None, **OPTIONS)(self._function)
        finally:
            numba.config.CACHE_LOCATOR_CLASSES = before

    @property
    def _source(self) -> Path:
        """The source file of the function."""
        return Path(self._function.__code__.co_filename)


@typeof_impl.register(Kernel)  # type: ignore[untyped-decorator]
def _type_of_called(called: Kernel, _context: object) -> Any:
    """Numba's type of a kernel that another kernel calls; it has to be compiled for this."""
    return numba.typeof(called.compiled)


def kernel(function: F) -> F:
    """Decorator that makes a function a kernel for the types of its annotations.

    Of the globals of its module, the function may use numbers, enumerations, arrays, classes of named tuples, kernels,
    intrinsics and types of numba's, `math` and numpy. Arguments that do not fit the annotations raise a TypeError.
    Division by zero gives the same result as in numpy.

    Raises:
        TypeError: the function uses something else; the cache would not notice its changes.
    """
    KERNELS.append(Kernel(cast(FunctionType, function)))
    return cast(F, KERNELS[-1])


def outer(called: F) -> F:
    """Decorator of a kernel that other kernels call: Python calls it as well, so it is loaded before a run."""
    cast(Kernel, called).outer = True
    return called


def load_kernels() -> None:
    """Load or compile all :func:`run_kernels`.

    To be called before the first step of a run: loading takes as long as several steps.
    """
    with without_collection():
        for used in run_kernels():
            used.loaded  # noqa: B018 - the property is cached


def run_kernels() -> list[Kernel]:
    """Returns all kernels defined so far, except those that only other kernels call, whose code contains them."""
    inner = {id(called) for caller in KERNELS for called in caller.uses}
    return [defined for defined in KERNELS if defined.outer or id(defined) not in inner]


def cache_directory(source: Path) -> Path | None:
    """Returns where machine code of kernels in the file `source` goes: the first writable of these folders, else None.

    `NUMBA_CACHE_DIR`, if set; `__pycache__` beside `source`; and `litsim/kernels` in the user's cache directory, for
    read-only installations.
    """
    user = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    named = [Path(numba.config.CACHE_DIR)] if numba.config.CACHE_DIR else []
    return next(filter(_writable, (*named, source.parent / "__pycache__", user / "litsim" / "kernels")), None)


class KernelLocator:
    """Tells numba where to cache a kernel, and under which name; see numba's `NUMBA_CACHE_LOCATOR_CLASSES`.

    The name depends on everything that the machine code depends on, so that a file is never stale or that of another
    kernel, however many processes compile at once. Numba's own locators only know the file of a function, not the
    kernels and constants that it uses from other files.
    """

    def __init__(self, directory: Path, stamp: str) -> None:
        self._directory, self._stamp = directory, stamp

    @classmethod
    def from_function(cls, function: FunctionType, file: str) -> KernelLocator | None:
        """Return the locator of a function; None if no cache directory is writable."""
        directory = cache_directory(Path(file))
        return None if directory is None else cls(directory, function.__dict__["stamp"])

    def ensure_cache_path(self) -> None:
        """Make the cache directory."""
        self._directory.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """Return the cache directory."""
        return str(self._directory)

    def get_source_stamp(self) -> str:
        """Return the stamp, which must be equal for machine code to be used."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """Return the stamp, which distinguishes files of functions with the same name."""
        return self._stamp


@cache
def _writable(directory: Path) -> bool:
    """Returns whether files can be made in `directory`, which is made if it is missing."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(directory, os.W_OK | os.X_OK)


@cache
def _leave_out_scipy() -> None:
    """Prevent numba from importing scipy's linear algebra, which takes half as long as loading all kernels.

    Numba imports it once, when it registers numpy's functions, to compile matrix products. Kernels must not use these.
    """
    if NUMBA_ARRAYS not in sys.modules:  # otherwise numba has already looked for it
        with left_out(SCIPY_BLAS):
            import_module(NUMBA_ARRAYS)


@cache
def announce() -> None:
    """Print once per process, and not in its copies, why it takes a while."""
    print("litsim: compiling kernels, once for this machine (about a minute)", file=sys.stderr, flush=True)


@cache
def _source_and_machine(file: str) -> bytes:
    """Returns the hash of a source file and :func:`_machine`."""
    return hashlib.sha256(Path(file).read_bytes() + _machine()).digest()


@cache
def _machine() -> bytes:
    """Returns what machine code depends on beside its source: version of numba, options, form, processor."""
    processor = f"{binding.get_host_cpu_name()} {binding.get_host_cpu_features().flatten()}"
    return f"{numba.__version__} {OPTIONS} {machine_code.FORM} {processor}".encode()


def _stamp(function: FunctionType, signature: Any) -> str:
    """Returns the hash of everything that the machine code of `function` depends on, as 16 hexadecimal digits."""
    code, names = function.__code__, function.__globals__
    digest = hashlib.sha256(_source_and_machine(code.co_filename))
    digest.update(f"{signature};".encode())
    for name in code.co_names:
        if name in names:
            digest.update(f"{name}={_constant(name, names[name])};".encode())
    return digest.hexdigest()[:16]


def _kernels_of(function: FunctionType) -> tuple[Kernel, ...]:
    """Returns the kernels that `function` calls."""
    named = map(function.__globals__.get, function.__code__.co_names)
    return tuple(value for value in named if isinstance(value, Kernel))


def _constant(name: str, value: object) -> str:
    """Returns a text that identifies a global `value`, which is frozen into kernels; raises TypeError if it cannot."""
    if isinstance(value, Kernel):
        return value.stamp
    if isinstance(value, type) and issubclass(value, tuple):
        value = tuple_type(value)
    if value is math or value is np:
        return ""
    if isinstance(value, EnumMeta):
        return repr(list(value))
    if isinstance(value, Intrinsic):  # taken to depend on its file only
        return _source_and_machine(value._defn.__code__.co_filename).hex()  # noqa: SLF001 - numba has no other way to it
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    if isinstance(value, bool | int | float | Enum | types.Type):  # types: numpy has attributes of their names
        return repr(value)
    raise TypeError(f"a kernel cannot use {name}: no number, enumeration, array, named tuple, kernel or intrinsic")
