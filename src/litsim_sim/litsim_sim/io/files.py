"""Folders, and atomic writing of files: each is written completely or not at all."""

from __future__ import annotations

import fcntl
import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from litsim_sim.core.errors import InputError


class Unwritable(InputError):
    """A file cannot be written, for lack of space or permission; the input is not at fault."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yields a new file beside `path`, with its suffix, that replaces it at the end of the block; its folder is made.

    If the block raises, or the program is killed, `path` is unchanged. A path that is neither file nor folder, such as
    /dev/stdout, is not replaced but written to.

    Raises:
        Unwritable: the file cannot be written.
    """
    if _is_special(path):
        try:
            yield path
        except OSError as error:
            raise _unwritable(path, error) from error
        return
    new = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield new
        new.replace(path)
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        with suppress(OSError):  # a folder that is none, of which the error above tells
            new.unlink()


def write_text(path: Path, text: str) -> None:
    """Writes a text in UTF-8, whole or not at all; raises as :func:`replacing`."""
    with replacing(path) as new:
        new.write_text(text, encoding="utf-8")


def write_json(path: Path, values: Any) -> None:
    """Writes values as JSON, likewise; raises ValueError if a number is not finite."""
    write_text(path, json.dumps(values, indent=1, allow_nan=False) + "\n")


def make_folder(path: Path) -> None:
    """Make the folder `path`, with those above it, unless it exists; raises Unwritable if it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from error


def require_new_folder(out: Path) -> None:
    """Raise InputError if something is at `out` that is no empty folder."""
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise InputError(f"{out}: exists already, expected a new folder: nothing is replaced")


def relative(path: Path, folder: Path) -> str:
    """Returns `path` as seen from `folder`, with slashes, as files that people may move together name each other."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def try_lock(file: int | IO[Any]) -> bool:
    """Locks an open file for this process until it is closed; returns False if another process has locked it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass  # a file system that has no locks
    return True


def refuse_input_as_output(out: Path, *inputs: Path) -> None:
    """Raise InputError if writing `out` replaces one of the `inputs` that it is made from."""
    for source in inputs:
        with suppress(OSError):  # a missing file: nothing is lost
            if out.samefile(source):
                raise InputError(f"{out}: is the input {source} itself, expected another file: nothing is replaced")


def _is_special(path: Path) -> bool:
    """Returns whether `path` exists and is neither a file nor a folder, but a device or a pipe."""
    try:
        mode = path.stat().st_mode
    except OSError:  # nothing is, or a folder on the way is none
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _unwritable(path: Path, error: OSError) -> Unwritable:
    return Unwritable(f"{path}: cannot be written: {error.strerror or error}")
