"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from litsim_sim.core.errors import InputError


class Unwritable(InputError):
    """A file that cannot be written: the input was fine, and with room and permission it would go on."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file beside `path`, with its ending, that takes its place when the block is done; its folder is made.

    Where the block raises, or the program is killed, `path` is as it was.

    Raises:
        Unwritable: the file cannot be written.
    """
    new = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield new
        new.replace(path)
    except OSError as error:
        raise Unwritable(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # a folder that is none: said above
            new.unlink()
