"""Command-line programs.

Once this package is imported, Ctrl-C ends the process without a traceback, also while a program is still loading;
:func:`.program.program` covers the rest.
"""

import sys
from types import TracebackType

_show = sys.excepthook


def _show_unless_interrupted(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        _show(kind, error, traceback)


sys.excepthook = _show_unless_interrupted
