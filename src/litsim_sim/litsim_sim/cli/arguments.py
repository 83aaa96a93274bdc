"""What command lines share: help that names defaults, numbers whose errors say what was expected."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from math import inf


class DefaultsFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Help that names the defaults of those options that have a value of their own."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        plain = action.default is None or action.default == [] or isinstance(action.default, bool)
        return action.help if plain else super()._get_help_string(action)


def number(low: float, high: float = inf, *, above: bool = False) -> Callable[[str], float]:
    """A type of finite numbers from `low` to `high`; greater than `low` where `above` is set."""
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
