"""DDS domains: which one a graph is to use, and that no other graph of this user is on it."""

from __future__ import annotations

import fcntl
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.launch.domain_ports import is_in_use

DOMAIN_IDS = range(233)  # DDS has no ports for larger ids
HOLDER = "LITSIM_DOMAIN_HOLDER"
"""Variable that tells the nodes of a graph which process holds their domain for them: its id."""
FREE_TRIES = 100  # domains tried until one is free
LETTING_GO_S = 1.0
"""[s] Wait for a run that is just ending: its last process releases the lock after it can no longer be seen."""
LOOK_S = 0.02  # [s] period of attempts to take the lock


class DomainInUse(InputError):
    """A graph of this user already uses the domain."""


def graph_domain(domain_id: int | None, *, reserve: bool) -> AbstractContextManager[int]:
    """The DDS domain of a graph, held for it: `domain_id`, else that of the environment.

    Where the user has chosen none: a free one that is reserved meanwhile, if `reserve`, else 0.

    Raises:
        InputError: there is no such domain; on entering, another graph is on it.
    """
    chosen = os.environ.get("ROS_DOMAIN_ID") if domain_id is None else str(domain_id)
    if not chosen and reserve:
        return _free_domain()
    chosen = chosen or "0"
    if not chosen.isdecimal() or int(chosen) not in DOMAIN_IDS:
        raise InputError(f"ROS_DOMAIN_ID is {chosen!r}, expected {DOMAIN_IDS[0]} to {DOMAIN_IDS[-1]}")
    return held_domain(int(chosen))


@contextmanager
def held_domain(domain_id: int, *, patience: float = LETTING_GO_S) -> Iterator[int]:
    """Hold a domain of this machine for one graph; a process that the holder has started for it may hold it, too.

    The lock is one of the operating system's on a file of this user: it is gone with the process, however that ends.
    For `patience` [s] it is waited for.

    Raises:
        DomainInUse: another graph is on it.
        InputError: the lock cannot be taken for another reason.
    """
    path = _folder() / f"domain_{domain_id}.lock"
    try:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise InputError(f"{path}: the lock of ROS_DOMAIN_ID {domain_id} cannot be had: {error.strerror}") from error
    try:
        until = time.monotonic() + patience
        while not _locked(descriptor):
            holder = os.pread(descriptor, 32, 0).decode(errors="replace").strip()
            if holder and holder in (os.environ.get(HOLDER), str(os.getpid())):
                break
            if time.monotonic() >= until:
                by = f" (process {holder})" if holder else ""
                raise DomainInUse(
                    f"ROS_DOMAIN_ID {domain_id}: another run of yours is on there{by}; choose another domain, or wait "
                    "for the end of that run"
                )
            time.sleep(LOOK_S)
        else:
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        yield domain_id
    finally:
        os.close(descriptor)


def _locked(descriptor: int) -> bool:
    """Try to lock an open file; return whether this process now holds the lock, which it may have held before."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def hold_for_this_process(domain_id: int) -> None:
    """Hold a domain until this process ends, for the nodes that it starts.

    Raises:
        DomainInUse: another graph is on it.
    """
    _held.enter_context(held_domain(domain_id))
    os.environ[HOLDER] = str(os.getpid())


_held = ExitStack()


@contextmanager
def _free_domain() -> Iterator[int]:
    import domain_coordinator  # of ROS, where the rest of this module is not

    with closing(ExitStack()) as reserved:  # closed, since domain_coordinator takes an OSError of the run for its own
        for _ in range(FREE_TRIES):
            domain_id = reserved.enter_context(domain_coordinator.domain_id())
            if is_in_use(domain_id):  # such as by a stack that was started by hand, or has outlived its run
                continue
            try:
                reserved.enter_context(held_domain(domain_id, patience=0.0))
            except DomainInUse:  # by a program that chose it: it stays reserved, so that the next is another
                continue
            yield domain_id
            return
        raise InputError("no DDS domain is free; give one with --domain-id")


def _folder() -> Path:
    """Folder of the locks of this user."""
    return Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()) / f"litsim-{os.getuid()}"
