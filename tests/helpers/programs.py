"""Programs of the repository that are in no package."""

import sys
from importlib.util import module_from_spec, spec_from_file_location
from types import ModuleType

from documentation import ROOT


def program(path: str) -> ModuleType:
    """Returns the program at a path from the root of the repository, as a module."""
    spec = spec_from_file_location(f"program_{(ROOT / path).stem}", ROOT / path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
