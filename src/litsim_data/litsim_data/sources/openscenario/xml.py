"""Reading of OpenSCENARIO XML: its parameters, expressions, catalogs and numbers."""

from __future__ import annotations

import ast
import copy
import math
import operator
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from litsim_sim.io.input_files import number_in, read_plain_xml, read_xml

CONTENT = "OpenSCENARIO file"
LARGEST = 1e7
"""Magnitude of numbers, at most: metres from the origin, as of recordings."""
EXPRESSION_MAX = 300  # characters
COPIED_MAX = 1_000_000  # elements of entries of catalogs that references may stand for, all together
PARAMETER = re.compile(r"\$(\w+)")
Scope = Mapping[str, str]
"""Values of parameters by name."""
OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: math.fmod,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
    ast.And: all,
    ast.Or: any,
}
FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "round": lambda value: math.floor(value + 0.5),
    "sign": lambda value: (value > 0.0) - (value < 0.0),
    "pow": math.pow,
    "abs": abs,
    "max": max,
    "min": min,
    **{name: getattr(math, name) for name in ("floor", "ceil", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan")},
}


class UnreadError(ValueError):
    """Part of a scenario that is not read, such as an action that is not simulated; the text names its element."""


def read_scenario(path: Path) -> ET.Element:
    """Returns the root of a scenario, with values in place of parameters, and entries in place of catalog references.

    References to entries that are not there, and expressions without a value, stay as they are.

    Raises:
        InputError: the file, or one of its catalogs, is no XML.
        UnreadError: entries of catalogs are copied too often.
    """
    root = read_plain_xml(path, CONTENT)
    for location in root.iterfind("CatalogLocations"):
        _fill_in(location, _declared(root, {}, {}))
    _fill_tree(root, _catalogs(root, path))
    return root


def number(element: ET.Element, name: str, default: float | None = None, most: float = LARGEST) -> float:
    """Returns an attribute that is a number of at most `most`; `default` where it is missing.

    Raises:
        UnreadError: the attribute is no such number, or is missing without a default.
    """
    if default is not None and element.get(name) is None:
        return default
    try:
        return number_in(element, name, most)
    except ValueError as error:
        raise UnreadError(str(error)) from error


def child(element: ET.Element, path: str) -> ET.Element:
    """Returns the first element at a path within an element; raises UnreadError where the path leads nowhere."""
    found = element.find(path)
    if found is None:
        raise UnreadError(f"element {element.tag} has no {path}")
    return found


def entity_in(scenario_object: ET.Element) -> ET.Element:
    """Returns the vehicle, pedestrian or other object that an element ScenarioObject holds."""
    return next((element for element in scenario_object if element.tag != "ObjectController"), scenario_object)


def box_of(scenario_object: ET.Element) -> tuple[float, float, float, float]:
    """Returns how far ahead and left of the reference point the middle of an entity's box is, its length and width [m].

    Raises:
        UnreadError: it has no box.
    """
    entity = entity_in(scenario_object)
    centre, size = child(entity, "BoundingBox/Center"), child(entity, "BoundingBox/Dimensions")
    return number(centre, "x"), number(centre, "y", 0.0), number(size, "length"), number(size, "width")


def value_of(text: str, scope: Scope) -> str:
    """Returns the value of an attribute: of a parameter `$name`, of an expression `${...}`, or the text itself.

    It is the text as well where a parameter is unknown, or the expression has no value.
    """
    if not text.startswith("${"):
        return scope.get(text[1:], text) if text.startswith("$") else text
    plain = PARAMETER.sub(lambda match: f"({scope.get(match[1], 'unknown')})", text.removesuffix("}")[2:])
    plain = re.sub(r"\b(true|false)\b", lambda match: match[0].capitalize(), plain)
    try:
        if len(plain) > EXPRESSION_MAX:
            return text
        value = _evaluated(ast.parse(plain.strip(), mode="eval").body)
        whole = not isinstance(value, bool) and value == math.floor(value)
    except (SyntaxError, ValueError, TypeError, ArithmeticError, LookupError, MemoryError, RecursionError):
        return text
    return str(value).lower() if isinstance(value, bool) else f"{value:.0f}" if whole else repr(float(value))


def _fill_in(whole: ET.Element, scope: Scope) -> None:
    """Puts the values of parameters and expressions in place of them, in an element and all that it holds."""
    for element in whole.iter():
        _fill(element, scope)


def _fill(element: ET.Element, scope: Scope) -> None:
    """Puts the values of parameters and expressions in place of them, in the attributes of an element."""
    for name, text in element.attrib.items():
        if "$" in text:
            element.attrib[name] = value_of(text, scope)


def _evaluated(node: ast.expr) -> float | bool:
    """Returns the value of an expression; raises LookupError for what the standard does not have."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return node.value if isinstance(node.value, bool) else float(node.value)
    if isinstance(node, ast.BinOp):
        return OPERATORS[type(node.op)](_evaluated(node.left), _evaluated(node.right))
    if isinstance(node, ast.UnaryOp):
        return OPERATORS[type(node.op)](_evaluated(node.operand))
    if isinstance(node, ast.BoolOp):
        return OPERATORS[type(node.op)]([_evaluated(value) for value in node.values])
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return FUNCTIONS[node.func.id](*map(_evaluated, node.args))
    raise LookupError(type(node).__name__)


def _declared(element: ET.Element, outer: Scope, assigned: Scope) -> Scope:
    """Returns the parameters in an element: those around it, and its own, as assigned or else as declared."""
    scope = {**outer}
    for parameter in element.findall("ParameterDeclarations/ParameterDeclaration"):
        name = parameter.get("name", "")
        scope[name] = assigned.get(name) or value_of(parameter.get("value", ""), scope)
    return scope


def _fill_tree(root: ET.Element, catalogs: Mapping[tuple[str, str], ET.Element]) -> None:
    """Puts values in place of parameters, and entries of catalogs in place of references, everywhere."""
    stack: list[tuple[ET.Element, Scope, Scope]] = [(root, {}, {})]
    left = COPIED_MAX
    while stack:
        element, outer, assigned = stack.pop()
        scope = _declared(element, outer, assigned)
        _fill(element, scope)
        for index, part in enumerate(element):
            own: dict[str, str] = {}
            if part.tag == "CatalogReference":
                _fill_in(part, scope)
                entry = catalogs.get((part.get("catalogName", ""), part.get("entryName", "")))
                if entry is not None:
                    assignments = part.findall("ParameterAssignments/ParameterAssignment")
                    own = {
                        assignment.get("parameterRef", ""): assignment.get("value", "") for assignment in assignments
                    }
                    left -= sum(1 for _ in entry.iter())
                    if left < 0:
                        raise UnreadError(f"its catalog references stand for more than {COPIED_MAX} elements")
                    element[index] = copy.deepcopy(entry)
            stack.append((element[index], scope, own))


def _catalogs(root: ET.Element, path: Path) -> Mapping[tuple[str, str], ET.Element]:
    """Returns the entries of the catalogs in the folders that a scenario names, by catalog and entry."""
    entries: dict[tuple[str, str], ET.Element] = {}
    for directory in root.findall("CatalogLocations/*/Directory"):
        for file in sorted((path.parent / directory.get("path", "")).glob("*.xosc")):
            for catalog in read_xml(file, CONTENT).findall("Catalog"):
                entries |= {(catalog.get("name", ""), entry.get("name", "")): entry for entry in catalog}
    return entries
