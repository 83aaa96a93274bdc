"""The error type for users, printing of errors, and the exit statuses of every program."""

from __future__ import annotations

import errno
import re
import reprlib
import sys
import traceback
from pathlib import Path

from litsim_sim.core.installation import installs

EXIT_FAILED = 1  # negative result: a run failed or is not valid, or a comparison found differences
EXIT_INPUT = 2  # input that cannot be used
EXIT_INTERRUPTED = 130  # Ctrl-C: 128 + SIGINT, as in shells
LONGEST = 4000  # most characters of an error: names of fields, frames and files may be as long as their author likes
DIGITS_MAX = 40
SHOWN_MAX = 60  # most characters of a wrong value that an error repeats
INTERRUPTED = "interrupted"
"""The :func:`reason` of a KeyboardInterrupt."""

_DIGITS = re.compile(f"[0-9]{{{DIGITS_MAX + 1},}}")


class InputError(Exception):
    """Input that cannot be used: the message names the file, line, field or topic and what was expected.

    Command-line programs print the message without a traceback and exit with status 2.
    """


def not_installed(what: str, package: str = "") -> InputError:
    """Returns the error for `what` is missing, an optional `package` or a part of it."""
    return InputError(f"{what} is not installed here, and this needs it: `{installs(package or what)}` installs it")


def without_ros(module: str) -> InputError:
    """Returns the error of a program that needs ROS 2, of which `module` is missing."""
    return InputError(f"this needs ROS 2, and there is no {module} here: build the workspace, and use its ./litsim")


def refused(error: OSError) -> InputError | None:
    """Returns an error of the input if the operating system refuses a path as such; None for any other `error`."""
    if error.filename is None or error.errno not in (errno.EACCES, errno.ENAMETOOLONG, errno.ENOSPC):
        return None
    return InputError(f"{error.filename}: {error.strerror}")


def print_error(what: object) -> None:
    """Print an error to stderr, as :func:`printable`."""
    print(f"error: {printable(str(what))}", file=sys.stderr)


def printable(text: str) -> str:
    """Returns `text` as people read it on terminals, in logs, records and reports, whoever has written it.

    It has at most `LONGEST` characters, no more than `DIGITS_MAX` digits in a row, and control characters, which steer
    terminals, as escapes.
    """
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} ... ({len(text) - LONGEST} characters) ... {text[-LONGEST // 2 :]}"
    text = _DIGITS.sub(lambda digits: f"{digits[0][:6]}... ({len(digits[0])} digits)", text)
    if text.replace("\n", "").isprintable():
        return text
    return "".join(c if c == "\n" or c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shown(value: object) -> str:
    """Returns `value` as an error repeats it: short, whatever it is and however large."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = short.maxlong = SHOWN_MAX
    return f"{short.repr(value):.{SHOWN_MAX}}"


def reason(error: BaseException) -> str:
    """Returns `error` as one line, with type and place unless it is an InputError or a KeyboardInterrupt."""
    text = " ".join(str(error).split())
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    if isinstance(error, InputError):
        return text
    innermost = traceback.extract_tb(error.__traceback__)[-1:]
    where = "".join(f" ({Path(frame.filename).name}, line {frame.lineno})" for frame in innermost)
    return f"{type(error).__name__}: {text}{where}"
