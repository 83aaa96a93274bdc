"""The loader of YAML from users: PyYAML reads YAML 1.1, whose numbers are not those that people and JSON write."""

from __future__ import annotations

import re
from typing import Any

import yaml

INT, FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
WITH_EXPONENT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$")


def _without_underscores(tag: str, pattern: re.Pattern[str]) -> re.Pattern[str]:
    return re.compile(f"(?!.*_){pattern.pattern}", pattern.flags) if tag in (INT, FLOAT) else pattern


class YamlLoader(yaml.SafeLoader):
    """PyYAML's safe loader, with numbers as in YAML 1.2: 1e-05 is one, as JSON writes it; 12_0 is text.

    Lanes have names such as 12_0 in nets of numbered edges.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012 - as PyYAML declares it
        first: [(tag, _without_underscores(tag, pattern)) for tag, pattern in resolvers]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


YamlLoader.add_implicit_resolver(FLOAT, WITH_EXPONENT, list("-+.0123456789"))


def load_yaml(text: str) -> Any:
    """Returns the value of a YAML text by :class:`YamlLoader`; raises yaml.YAMLError where it is none."""
    return yaml.load(text, YamlLoader)  # noqa: S506 - a SafeLoader
