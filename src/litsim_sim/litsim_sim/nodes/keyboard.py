"""Single keys from a terminal, without waiting for Enter."""

from __future__ import annotations

import os
import re
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Self

_KEY = re.compile(r"\x1b.{0,2}|.", re.DOTALL)
_SEQUENCES = {"\x1b[C": "right", "\x1b[D": "left", "\x1bOC": "right", "\x1bOD": "left"}


class Keyboard:
    """Keys pressed since the last call; none if standard input is not a terminal.

    A context manager that restores the terminal on exit, also after an error.
    """

    def __init__(self) -> None:
        mine = sys.stdin is not None and sys.stdin.isatty() and _in_foreground(sys.stdin.fileno())
        self._descriptor = sys.stdin.fileno() if mine else -1
        self._before: list[object] | None = None

    @property
    def there(self) -> bool:
        """Whether there is a terminal."""
        return self._descriptor >= 0

    def __enter__(self) -> Self:
        if self.there:
            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._before is not None:
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)  # type: ignore[arg-type]

    def pressed(self) -> list[str]:
        """Characters, and `left` and `right` for the arrows."""
        if not self.there or not select.select([self._descriptor], [], [], 0.0)[0]:
            return []
        return split_keys(os.read(self._descriptor, 64).decode(errors="replace"))


def _in_foreground(descriptor: int) -> bool:
    """Returns whether this process is in the foreground: a background job that uses its terminal is stopped."""
    try:
        return os.tcgetpgrp(descriptor) == os.getpgrp()
    except OSError:  # a terminal without job control
        return True


def split_keys(text: str) -> list[str]:
    """Returns the keys in the output of a terminal; escape sequences other than the arrows are dropped."""
    keys = (_SEQUENCES.get(part, "") if part[0] == "\x1b" else part for part in _KEY.findall(text))
    return [key for key in keys if key]
