"""The loader of all YAML: numbers as people and JSON write them, and bounds on what a text may ask for."""

from __future__ import annotations

import re
from typing import Any

import yaml

TAGS = "tag:yaml.org,2002:"
INT, FLOAT = f"{TAGS}int", f"{TAGS}float"
DEEPEST = 50  # most levels of nested lists and mappings; usual files have two or three
NODES_MAX = 250_000  # most values of a text, those of an alias counted at each use; reading so many takes ten seconds
WITH_EXPONENT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$")


def _without_underscores(tag: str, pattern: re.Pattern[str]) -> re.Pattern[str]:
    return re.compile(f"(?!.*_){pattern.pattern}", pattern.flags) if tag in (INT, FLOAT) else pattern


class YamlLoader(yaml.SafeLoader):
    """PyYAML's safe loader, with numbers as in YAML 1.2: 1e-05 is one, as JSON writes it; 12_0 is text.

    Lanes have names such as 12_0 in nets of numbered edges. Equal keys are refused, and so is a text that is deeper
    than `DEEPEST` or has more values than `NODES_MAX`: aliases make billions of a few hundred bytes.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012 - as PyYAML declares it
        first: [(tag, _without_underscores(tag, pattern)) for tag, pattern in resolvers]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, stream: str | bytes) -> None:
        super().__init__(stream)
        self._depth, self._count = 0, 0
        self._sizes: dict[int, int] = {}  # of nodes by id, with all in them

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Returns the next node, as PyYAML composes it; raises yaml.YAMLError beyond the bounds."""
        mark, is_alias, before = self.peek_event().start_mark, self.check_event(yaml.AliasEvent), self._count
        self._depth += 1
        if self._depth > DEEPEST:
            raise yaml.MarkedYAMLError(problem=f"nested deeper than {DEEPEST} levels", problem_mark=mark)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        if is_alias:
            if id(node) not in self._sizes:
                raise yaml.MarkedYAMLError(problem="an alias of what it is part of", problem_mark=mark)
            self._count += self._sizes[id(node)]
        else:
            self._count += 1
            self._sizes[id(node)] = self._count - before
        if self._count > NODES_MAX:
            raise yaml.MarkedYAMLError(
                problem=f"more than {NODES_MAX} values, those of aliases counted at each use", problem_mark=mark
            )
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Returns the value of a node, as PyYAML does; raises yaml.YAMLError if it does not fit the tag of the node."""
        try:
            return super().construct_object(node, deep)
        except (AttributeError, LookupError, ValueError, OverflowError) as error:
            because = f": {error}" if isinstance(error, ValueError) else ""
            text = f"{node.tag.replace(TAGS, '!!')} has no value {node.value!r:.60}{because}"
            raise yaml.MarkedYAMLError(problem=text, problem_mark=node.start_mark) from error

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Returns a mapping, as PyYAML does; raises yaml.YAMLError if a key occurs twice."""
        names = set[Any]()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in names:
                raise yaml.MarkedYAMLError(problem=f"key {key.value!r:.60} occurs twice", problem_mark=key.start_mark)
            names.add(key.value if isinstance(key, yaml.ScalarNode) else key)
        return super().construct_mapping(node, deep)


YamlLoader.add_implicit_resolver(FLOAT, WITH_EXPONENT, list("-+.0123456789"))


def load_yaml(text: str | bytes) -> Any:
    """Returns the value of a YAML text by :class:`YamlLoader`; raises yaml.YAMLError where it is none."""
    return yaml.load(text, YamlLoader)  # noqa: S506 - a SafeLoader
