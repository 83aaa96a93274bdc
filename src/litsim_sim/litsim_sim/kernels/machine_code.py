"""Machine code of functions compiled by numba, kept on disk so that it can be loaded without the compiler.

Numba's own cache also serves to compile further functions: before it is read, numba registers all functions that it
supports (0.12 s), and it contains the code of called functions in another form as well (4 ms per function). Here only
the machine code is kept (0.5 ms).
"""

from __future__ import annotations

import ctypes
import os
import pickle
import sys
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from llvmlite import binding
from numba import _dynfunc, types
from numba.core import pythonapi
from numba.core.compiler import compile_result
from numba.core.registry import cpu_target
from numba.core.runtime import _nrt_python

FORM = "arrays boxed quickly"  # form of the machine code; code that was compiled in another form is not used

_environments: dict[str, Any] = {}  # environments of loaded machine code, which refers to them by address


def box_arrays_quickly() -> None:
    """Make functions compiled from now on return arrays without a lookup of their class in Python.

    Numba stores the class in a function's code, pickled, and looks it up by a Python function for every returned array,
    which takes half of the time of returning it. Here the class is one of the function's constants, like the type of
    the elements. Thus no Python code runs within a kernel, where Ctrl-C would be raised as an error of numba.
    """
    from numba.core import boxing  # a process that compiles nothing does not need it

    def box_array(array: Any, value: Any, context: Any) -> Any:
        api, environment = context.pyapi, context.env_manager
        array_class = environment.read_const(environment.add_const(array.box_type))
        api.unserialize = lambda _: array_class  # for this object only, and restored below
        try:
            return boxing.box_array(array, value, context)
        finally:
            del api.unserialize

    pythonapi._boxers.functions[types.Array] = box_array  # noqa: SLF001 - numba's register() refuses a second one


def keep(path: Path, dispatcher: Any, signature: Any) -> None:
    """Write to `path`, in an existing folder, machine code for `signature` from numba's cache, if it is there.

    The `dispatcher` is numba's, with a cache, and has been compiled for that.
    """
    cached = dispatcher._cache  # noqa: SLF001 - numba has no public access to it
    entry = cached._cache_file.load(cached._index_key(signature, cpu_target.target_context.codegen()))  # noqa: SLF001
    if entry is None:
        return
    (_, kind, code), described, own, *_, others = entry
    if kind != "object":
        return
    environments = [(environment.env_name, list(environment.consts)) for environment in (own, *others)]
    content = (str(signature), code[0], described.llvm_cpython_wrapper_name, environments)
    new = path.with_name(f"{path.name}.{os.getpid()}")
    new.write_bytes(pickle.dumps(content))
    new.replace(path)  # atomically: other processes may be reading it, or compiling the same function


def load(path: Path, function: FunctionType, signature: Any, options: dict[str, Any]) -> Any:
    """Load machine code into a dispatcher of `function`, for calls only; None if there is none for `signature`."""
    try:
        text, code, entry, environments = pickle.loads(path.read_bytes())  # noqa: S301 - as numba's own cache
    except FileNotFoundError:
        return None
    if text != str(signature):
        return None
    engine = _engine()
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    for name, constants in environments:
        address = engine.get_global_value_address(name)
        ctypes.c_void_p.from_address(address).value = id(_environment(name, constants, function))
    own = _environments[environments[0][0]]
    module, name = sys.modules[function.__module__], function.__name__
    called = _dynfunc.make_function(module, name, function.__doc__ or "", engine.get_function_address(entry), own, ())
    dispatcher = numba.njit(**options)(function)
    dispatcher.add_overload(compile_result(signature=signature, entry_point=called, objectmode=False))
    dispatcher.disable_compile()
    return dispatcher


def _environment(name: str, constants: list[Any], function: FunctionType) -> Any:
    """Returns the environment in which machine code looks up Python objects; all code of that `name` shares it."""
    if name not in _environments:
        environment = _environments[name] = _dynfunc.Environment(function.__globals__)
        environment.consts[:] = constants
    return _environments[name]


@cache
def _engine() -> Any:
    """Returns the engine that links machine code in this process with the functions that it may call."""
    cpu_target.target_context  # noqa: B018 - registers Python's functions, mathematical ones and numba's own
    for name, address in _nrt_python.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
    machine = binding.Target.from_triple(binding.get_process_triple()).create_target_machine()
    nothing = binding.parse_assembly("")
    return binding.create_mcjit_compiler(nothing, machine, use_lmm=numba.config.USE_LLVMLITE_MEMORY_MANAGER)
