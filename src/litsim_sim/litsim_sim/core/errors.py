"""The one error type that a user is meant to read, and the exit statuses of every program."""

from __future__ import annotations

EXIT_FAILED = 1  # the program did its work, and the answer is no: a run that failed or is not valid, a difference
EXIT_INPUT = 2  # input that cannot be used
EXIT_INTERRUPTED = 130  # Ctrl-C, as shells count it


class InputError(Exception):
    """Input that cannot be used: the message names the file, line, field or topic and what was expected.

    Command-line programs print the message without a traceback and exit with status 2.
    """
