"""Common parts of command lines: errors in one line, defaults in help, and checked numbers."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from copy import copy
from math import inf
from typing import Any, NoReturn

from litsim_sim.core.errors import EXIT_INPUT, print_error

COMMAND = "--"
"""Separator before the command of a stack, which is not parsed."""


class Parser(argparse.ArgumentParser):
    """An argparse parser with errors in one line that refuses empty values, and lists in two parts.

    An empty value usually comes from an unset variable in a script; a default or the current folder would not be what
    was meant. Of an option that takes a list and comes twice, argparse would drop the first list.
    """

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """See :class:`argparse.ArgumentParser`."""
        argv = sys.argv[1:] if args is None else list(args)
        self._check_values(argv[: argv.index(COMMAND)] if COMMAND in argv else argv)
        return super().parse_known_args(argv, namespace)

    def error(self, message: str) -> NoReturn:
        """Print `message` in one line, and exit as for bad input."""
        print_error(f"{' '.join(message.split())}; see {self.prog} --help")
        sys.exit(EXIT_INPUT)

    def _check_values(self, argv: Iterable[str]) -> None:
        option, lists = "", set()
        for argument in argv:
            if argument.startswith("--"):
                option = argument.partition("=")[0]
                action = self._option_string_actions.get(option)
                if option in lists:
                    self.error(f"argument {option}: comes twice, expected once, with all its values")
                if action and action.nargs in {argparse.ONE_OR_MORE, argparse.ZERO_OR_MORE}:
                    lists.add(option)
            if not argument or (argument == f"{option}=" and option):
                what = f"argument {option}" if option else "an argument"
                self.error(f"{what}: nothing in it, expected a value (is a variable not set?)")


class DefaultsFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Help with the defaults of all options that have one."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        plain = action.default is None or action.default == [] or isinstance(action.default, bool)
        return action.help if plain else super()._get_help_string(action)

    def _expand_help(self, action: argparse.Action) -> str:
        if isinstance(action.default, list) and action.default:  # as it would be typed
            action = copy(action)
            action.default = " ".join(map(str, action.default))
        return super()._expand_help(action)


def number(low: float, high: float = inf, *, above: bool = False) -> Callable[[str], float]:
    """Returns an argparse type of finite numbers from `low` to `high`; greater than `low` if `above`."""
    least = f"more than {low:g}" if above else f"at least {low:g}"
    expected = f"a number of {least}" + (f" and at most {high:g}" if high < inf else "")

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = inf
        if not low <= value <= high or value == inf or (above and value == low):
            raise argparse.ArgumentTypeError(f"{text!r}, expected {expected}")
        return value

    return parse


positive = number(0.0, above=True)
