"""Writes the YAML files of the nodes' parameters: each with its default, its unit and its meaning.

    ./litsim exec python tools/parameters.py

All of it is taken from the configuration classes. A test finds files that are out of date.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import yaml

from litsim_sim.core import plugins
from litsim_sim.core.parameters import Config, ParameterOverrides
from litsim_sim.core.plugins import stage_reader
from litsim_sim.core.quantities import field_type, unit
from litsim_sim.core.stages import EGO
from litsim_sim.scenario.run_info import driver_names

SOURCES = Path(__file__).resolve().parents[1] / "src"
HOME = {"bridge": "litsim_sim", "recorder": "litsim_sim", "predictor": "litsim_predictor"}
"""Packages of the stages that are not in litsim_policy. What others add to a stage stands in their `plugins.yaml`."""
ATTRIBUTE = re.compile(r"^ {4}(\w+(?:, \w+)*): (.*(?:\n {8}.*)*)", re.MULTILINE)
ROLE = re.compile(r":\w+:`[~.]?(?:\w+\.)*([^`]*)`")
WIDTH = 116  # characters of a comment


class Described(ParameterOverrides):
    """Reads the configurations of a stage, and notes what is to be written about their fields.

    Attributes:
        lines: of YAML, by package.
    """

    def __init__(self, stage: str) -> None:
        super().__init__(stage, {})
        self.lines: dict[str, list[str]] = {}
        self._package = ""

    def __call__(self, default: Config, prefix: str = "") -> Config:
        """See :class:`litsim_sim.core.parameters.ParameterOverrides`."""
        kind, outermost = type(default), not self._package
        if outermost:
            self._package = kind.__module__.partition(".")[0]
        lines, meaning = self.lines.setdefault(self._package, []), meanings(kind)
        leaves = [f.name for f in fields(default) if not is_dataclass(getattr(default, f.name))]  # type: ignore[arg-type]
        new = [name for name in leaves if prefix + name not in self.values]
        if new:
            lines += ["", *comment(str(inspect.getdoc(kind)).partition("\n")[0]), ""]
        for name in new:
            lines += parameter(prefix + name, getattr(default, name), field_type(kind, name), meaning[name])
        read = super().__call__(default, prefix)
        if outermost:
            self._package = ""
        return read


def meanings(kind: type) -> dict[str, str]:
    """What the docstrings of a configuration and of its base classes say about each field."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        _, _, attributes = str(inspect.getdoc(base)).partition("Attributes:\n")
        for names, text in ATTRIBUTE.findall(attributes):
            found |= dict.fromkeys(names.split(", "), " ".join(text.split()))
    return found


def parameter(name: str, value: Any, kind: Any, meaning: str) -> list[str]:
    """The lines of YAML of one parameter."""
    text = f"[{unit(kind)}] {meaning}" if unit(kind) else meaning[0].upper() + meaning[1:]
    choices = [str(choice) for choice in get_args(kind)] if get_origin(kind) is Literal else []
    if any(choice not in meaning for choice in choices):
        text += f" One of {', '.join(choices)}."
    written = yaml.safe_dump(list(value) if isinstance(value, tuple) else value, default_flow_style=True)
    return [*comment(text), f"    {name}: {written.removesuffix('...' + chr(10)).strip()}"]


def comment(text: str) -> list[str]:
    """The lines of a comment."""
    return textwrap.wrap(ROLE.sub(r"\1", text), WIDTH, initial_indent="    # ", subsequent_indent="    # ")


def files() -> Mapping[Path, str]:
    """The text of each file of parameters."""
    stages = {stage: (stage, "") for stage in plugins.names(plugins.STAGES)}
    stages |= {f"{EGO}_{driver}": (EGO, driver) for driver in driver_names()}
    texts: dict[Path, str] = {}
    for name, (stage, driver) in stages.items():
        read = Described(name)
        stage_reader(stage, driver)(read)
        for package, lines in read.lines.items():
            at_home = bool(driver) or package == HOME.get(stage, "litsim_policy")
            file = SOURCES / package / "config" / f"{name if at_home else 'plugins'}.yaml"
            head = "# Defaults of parameters, written from the configuration classes by tools/parameters.py.\n"
            texts[file] = texts.get(file, head) + "\n".join([f"{stage}:", "  ros__parameters:", *lines[1:]]) + "\n"
    return texts


if __name__ == "__main__":
    for path, content in files().items():
        path.write_text(content, encoding="utf-8")
