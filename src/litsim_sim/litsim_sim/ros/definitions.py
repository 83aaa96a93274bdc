"""Message definitions and type hashes, for the recorder."""

from __future__ import annotations

import json
import re
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory

_SEPARATOR = "\n" + "=" * 80 + "\n"
_PRIMITIVE = re.compile(r"^(bool|byte|char|float32|float64|u?int(8|16|32|64)|w?string)\b")


def type_name(message_type: Any) -> str:
    """Returns `package/msg/Name` of a message class."""
    package, kind, _ = message_type.__module__.split(".", 2)
    return f"{package}/{kind}/{message_type.__name__}"


def message_class(name: str) -> Any:
    """Returns the class of `package/msg/Name`; raises ImportError or AttributeError if that is not installed."""
    package, kind, short = [*name.split("/"), "", ""][:3]
    return getattr(import_module(f"{package}.{kind}"), short)


@cache
def definition(name: str) -> str:
    """Returns the definition of `package/msg/Name` with those of all its types, in the `ros2msg` encoding of MCAP."""
    package, _, short = name.split("/")
    types = [(package, short)]
    for package, short in types:  # which grows meanwhile
        dependencies = dict.fromkeys(_dependencies(package, _read(package, short)))
        types += [dependency for dependency in dependencies if dependency not in types]
    others = (f"MSG: {package}/{short}\n{_read(package, short)}" for package, short in types[1:])
    return _SEPARATOR.join([_read(*types[0]), *others])


@cache
def type_hash(name: str) -> str:
    """Type hash `RIHS01_...` of `package/msg/Name`, from the file that rosidl has generated; empty without one."""
    package, kind, short = name.split("/")
    path = Path(get_package_share_directory(package)) / kind / f"{short}.json"
    if not path.is_file():
        return ""
    hashes = {entry["type_name"]: entry["hash_string"] for entry in json.loads(path.read_text())["type_hashes"]}
    return str(hashes[name])


@cache
def _read(package: str, short: str) -> str:
    return (Path(get_package_share_directory(package)) / "msg" / f"{short}.msg").read_text()


def _dependencies(package: str, text: str) -> list[tuple[str, str]]:
    """Returns the types other than primitives that a definition names, in its order."""
    types = []
    for line in text.splitlines():
        field_type = line.split("#", 1)[0].strip().split(" ", 1)[0].split("[", 1)[0]
        if field_type and not _PRIMITIVE.match(field_type):
            owner, _, short = field_type.rpartition("/")
            types.append((owner or package, short))
    return types
