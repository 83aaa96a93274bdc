"""Machine code of a function that numba has compiled, kept on disk so that it is loaded without the compiler.

What numba keeps itself is made to be compiled with: before it is read, a process learns all functions that numba knows
(0.12 s), and it brings the code of what it calls in another form as well (4 ms a function). This is the machine code
alone (0.5 ms).
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

FORM = "arrays boxed quickly"  # of machine code: what was compiled in another is not used

_environments: dict[str, Any] = {}  # of machine code that is loaded, which refers to them by their addresses


def box_arrays_quickly() -> None:
    """Have what is compiled from now on return arrays without asking Python which class they are of.

    numba keeps the class among a function's code, pickled, and looks it up by a function of Python for every array that
    is returned: half of what that costs. Here it is one of the function's constants, as the type of its elements is. So
    no Python runs in a kernel either, where Ctrl-C would be raised as an error of numba's.
    """
    from numba.core import boxing  # which a process that compiles nothing does not need

    def box_array(array: Any, value: Any, context: Any) -> Any:
        api, known = context.pyapi, context.env_manager
        found = known.read_const(known.add_const(array.box_type))
        api.unserialize = lambda _: found  # of this object alone, and no longer
        try:
            return boxing.box_array(array, value, context)
        finally:
            del api.unserialize

    pythonapi._boxers.functions[types.Array] = box_array  # noqa: SLF001 - numba's register() refuses a second one


def keep(path: Path, dispatcher: Any, signature: Any) -> None:
    """Keep at `path` what numba's cache has of a function for a signature; nothing where it has nothing.

    Args:
        path: the file, in an existing folder.
        dispatcher: numba's, of the function, with a cache.
        signature: numba's, of one of the types that it is compiled for.
    """
    cached = dispatcher._cache  # noqa: SLF001 - numba has no other way to it
    found = cached._cache_file.load(cached._index_key(signature, cpu_target.target_context.codegen()))  # noqa: SLF001
    if found is None:
        return
    (_, kind, code), described, environment, *_, others = found
    if kind != "object":
        return
    environments = [(each.env_name, list(each.consts)) for each in (environment, *others)]
    kept = (str(signature), code[0], described.llvm_cpython_wrapper_name, environments)
    made = path.with_name(f"{path.name}.{os.getpid()}")
    made.write_bytes(pickle.dumps(kept))
    made.replace(path)  # at once: others may be reading, or compiling the same


def load(path: Path, function: FunctionType, signature: Any, options: dict[str, Any]) -> Any:
    """Numba's dispatcher of `function`, of what is kept at `path`: it can be called, and nothing compiled with it.

    Returns:
        the dispatcher, None where nothing is kept for `signature`.
    """
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
    """What machine code finds objects of Python in; of a function that several have in theirs, there is one."""
    if name not in _environments:
        made = _environments[name] = _dynfunc.Environment(function.__globals__)
        made.consts[:] = constants
    return _environments[name]


@cache
def _engine() -> Any:
    """What links machine code, in this process, with all that it may call."""
    cpu_target.target_context  # noqa: B018 - makes Python's functions, those of mathematics and numba's own known
    for name, address in _nrt_python.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
    machine = binding.Target.from_triple(binding.get_process_triple()).create_target_machine()
    nothing = binding.parse_assembly("")
    return binding.create_mcjit_compiler(nothing, machine, use_lmm=numba.config.USE_LLVMLITE_MEMORY_MANAGER)
