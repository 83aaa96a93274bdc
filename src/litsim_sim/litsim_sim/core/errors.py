"""The one error type that a user is meant to read, how errors are told, and the exit statuses of every program."""

from __future__ import annotations

import sys
import traceback
from pathlib import Path

EXIT_FAILED = 1  # the program did its work, and the answer is no: a run that failed or is not valid, a difference
EXIT_INPUT = 2  # input that cannot be used
EXIT_INTERRUPTED = 130  # Ctrl-C, as shells count it
INTERRUPTED = "interrupted"
"""The reason of what a signal has ended."""


class InputError(Exception):
    """Input that cannot be used: the message names the file, line, field or topic and what was expected.

    Command-line programs print the message without a traceback and exit with status 2.
    """


def not_installed(package: str) -> InputError:
    """The error of what needs a `package` that runs do not, and that is not there."""
    return InputError(f"{package} is not installed here, and this needs it: `make setup-all` installs it")


def print_error(what: object) -> None:
    """Tell the user of an error, on stderr."""
    print(f"error: {what}", file=sys.stderr)


def reason(error: BaseException) -> str:
    """`error` in one line; one that nobody foresaw also says where it was raised."""
    text = " ".join(str(error).split())
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    if isinstance(error, InputError):
        return text
    at = traceback.extract_tb(error.__traceback__)[-1:]
    where = "".join(f" ({Path(frame.filename).name}, line {frame.lineno})" for frame in at)
    return f"{type(error).__name__}: {text}{where}"
