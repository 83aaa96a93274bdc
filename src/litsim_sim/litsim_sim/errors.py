"""The one error type that a user is meant to read."""

from __future__ import annotations


class InputError(Exception):
    """Input that cannot be used: the message names the file, line, field or topic and what was expected.

    Command-line programs print the message without a traceback and exit with status 2.
    """
