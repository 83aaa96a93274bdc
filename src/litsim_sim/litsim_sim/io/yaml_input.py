"""Reading of YAML files of users into pydantic models; errors name line and field."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from litsim_sim.core import yaml_loader
from litsim_sim.core.errors import InputError, shown
from litsim_sim.io.input_files import open_input

SHOWN = 5  # most problems that one message lists
TEXT_MAX = 8 * 2**20  # [B] most of a text file; those of usual suites and scenarios have some thousands
STREAM_NAME = re.compile(r' in "<(?:unicode|byte) string>",')  # PyYAML's for a text without a file
MISNAMED = ("missing", "extra_forbidden")  # pydantic's types of problems with names, not values

_Model = TypeVar("_Model", bound=BaseModel)


def read_yaml(path: Path, model: type[_Model]) -> _Model:
    """Read the YAML file at `path` (UTF-8) and check it against a pydantic `model`.

    Raises:
        InputError: it cannot be read, is not YAML, holds no fields, or some do not fit.
    """
    text = read_text(path)
    return validate_yaml(parse_yaml(text, str(path), model), model, str(path), text)


def read_text(path: Path) -> str:
    """Read a text in UTF-8 of at most `TEXT_MAX` bytes; raises InputError if it is none."""
    try:
        with io.TextIOWrapper(open_input(path, size_max=TEXT_MAX), encoding="utf-8") as file:
            return file.read()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read as UTF-8 text: {error}") from error


def load_yaml(text: str | bytes, where: str) -> Any:
    """Returns the content of a YAML text, of any type; `where` names the text in errors.

    Raises:
        InputError: it is not YAML, gives a key twice, or goes beyond the bounds of the loader.
    """
    try:
        return yaml_loader.load_yaml(text)
    except yaml.YAMLError as error:
        reason = STREAM_NAME.sub(",", " ".join(str(error).split()))  # `where` has named the file
        raise InputError(f"{where}: malformed YAML: {reason}") from error


def parse_yaml(text: str | bytes, where: str, model: type[BaseModel]) -> dict[str, Any]:
    """Returns the fields of a YAML text, not yet checked; `where` names the text in errors, `model` what was expected.

    Raises:
        InputError: it is not YAML, or holds something else than fields and values.
    """
    values = load_yaml(text, where)
    if not isinstance(values, dict):
        some = ", ".join(list(model.model_fields)[:4])
        raise InputError(f"{where}: expected fields such as {some}, found {shown(values)}")
    return values


def validate_yaml(values: dict[str, Any], model: type[_Model], where: str, text: str | bytes) -> _Model:
    """Returns `values`, read from `text` and possibly changed since, as a `model`; `where` names the text in errors.

    Raises:
        InputError: some fields do not fit: they are named, with their lines in `text`.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        problems = error.errors()
        described = "; ".join(_described(problems[:SHOWN], text))
        more = f"; and {len(problems) - SHOWN} more" if len(problems) > SHOWN else ""
        misnamed = any(problem["type"] in MISNAMED and len(problem["loc"]) == 1 for problem in problems)
        hint = f"; known fields: {', '.join(model.model_fields)}" if misnamed else ""
        raise InputError(f"{where}: {described}{more}{hint}") from error


def place_in(path: Path, *place: int | str) -> str:
    """Returns a text on the field at `place` in the YAML file at `path`, as in errors of :func:`validate_yaml`."""
    return f"{path}: {_place_text(yaml.compose(read_text(path), Loader=yaml.SafeLoader), place)}"


def _described(problems: list[ErrorDetails], text: str | bytes) -> Iterator[str]:
    """Yields where each problem is in `text`, what was expected, and the value there unless it is long or known."""
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    for problem in problems:
        plain = isinstance(problem["input"], str | int | float | None)
        message = problem["msg"].removeprefix("Value error, ")
        complete = not plain or problem["type"] in MISNAMED or ", found " in message
        value = "" if complete else f", found {shown(problem['input'])}"
        yield f"{_place_text(root, problem['loc'])}: {message}{value}"


def _place_text(node: yaml.Node | None, place: tuple[int | str, ...]) -> str:
    """Returns a text that names a field as the YAML text does, with the line of its innermost part that is there.

    If a field may have one of several types, pydantic puts the name of the one that it has tried into the place.
    """
    line, parts = "", list[str]()
    for number, part in enumerate(place):
        inner = _inner(node, part)
        if inner is None and node is not None and isinstance(part, str) and _is_choice(node, place[number + 1 :]):
            continue
        parts.append(str(part))
        node = None
        if inner is not None:
            line, node = f"line {inner[0].start_mark.line + 1}, ", inner[1]
    return f"{line}field {'.'.join(parts)}" if parts else "the fields together"


def _inner(node: yaml.Node | None, part: int | str) -> tuple[yaml.Node, yaml.Node] | None:
    """Returns where `part` of `node` begins, and its value; None if the text has none."""
    if isinstance(node, yaml.MappingNode):
        return {str(key.value): (key, value) for key, value in node.value}.get(str(part))
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
        return node.value[part], node.value[part]
    return None


def _is_choice(node: yaml.Node, rest: tuple[int | str, ...]) -> bool:
    """Returns whether a part that `node` lacks, before the `rest`, is a type that pydantic tried, not a field."""
    return not isinstance(node, yaml.MappingNode) or any(_inner(node, after) is not None for after in rest[:1])
