"""DDS domains: which one a graph is to use, that no other graph of this user is on it, and whether anybody is in it."""

from __future__ import annotations

import errno
import os
import socket
import stat
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import try_lock
from litsim_sim.launch.middleware import LOOPBACK, PROFILES, middleware_settings

DOMAIN_IDS = range(233)  # DDS has no ports for larger ids
FIRST_PORT, DOMAIN_PORTS = 7400, 250
"""First UDP port of domain 0, and number of ports of each domain (DDSI-RTPS 2.5, 9.6.2: PB, DG)."""
TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))
"""The UDP sockets of this machine, or of this container, as Linux lists them."""
HOLDER = "LITSIM_DOMAIN_HOLDER"
"""Variable that tells the nodes of a graph which process holds their domain for them: its id."""
EMPTY = "LITSIM_DOMAIN_EMPTY"
"""Variable that tells the bridge of a graph which domain was empty before any process of that graph was there."""
FREE_TRIES = 100  # domains tried until one is free
RELEASE_S = 1.0
"""[s] Wait for a run that is just ending: its last process releases the lock after it can no longer be seen."""
LOOK_S = 0.02  # [s] period of attempts to take the lock


class DomainInUse(InputError):
    """A graph of this user already uses the domain."""


def graph_domain(domain_id: int | None, *, reserve: bool) -> AbstractContextManager[int]:
    """Returns the DDS domain of a graph, held for it: `domain_id`, else that of the environment.

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
def held_domain(domain_id: int, *, patience: float = RELEASE_S) -> Iterator[int]:
    """Hold a domain of this machine for one graph; a process that the holder has started for it may hold it, too.

    The lock is one of the operating system's on a file of this user: it is gone with the process, however that ends.
    For `patience` [s] it is waited for.

    Raises:
        DomainInUse: another graph is on it.
        InputError: the lock cannot be taken for another reason.
    """
    folder = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()) / f"litsim-{os.getuid()}"
    path = folder / f"domain_{domain_id}.lock"
    try:
        descriptor = _open_own(folder, path)
    except OSError as error:
        raise InputError(f"{path}: the lock of ROS_DOMAIN_ID {domain_id} cannot be had: {error.strerror}") from error
    try:
        until = time.monotonic() + patience
        while not try_lock(descriptor):
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


def _open_own(folder: Path, path: Path) -> int:
    """Open a file in a folder, both made if need be and this user's alone: others write into /tmp, too, and put links.

    Raises:
        OSError: the folder is another's or others may write into it, or the path is no file of this user's.
    """
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if (
        not stat.S_ISDIR(status.st_mode)
        or status.st_uid != os.getuid()
        or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    ):
        raise OSError(errno.EPERM, f"{folder} is not a folder of yours alone, expected one that only you can write")
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_uid != os.getuid() or status.st_nlink != 1:
        os.close(descriptor)
        raise OSError(errno.EPERM, "it is not a file of yours alone")
    return descriptor


def hold_for_this_process(domain_id: int) -> None:
    """Hold a domain until this process ends, for the nodes that it starts; raises as :func:`held_domain`."""
    _held.enter_context(held_domain(domain_id))
    os.environ[HOLDER] = str(os.getpid())


_held = ExitStack()


@contextmanager
def _free_domain() -> Iterator[int]:
    import domain_coordinator  # of ROS, where the rest of this module is not

    with closing(ExitStack()) as reserved:  # closed, since domain_coordinator takes an OSError of the run for its own
        for _ in range(FREE_TRIES):
            domain_id = reserved.enter_context(domain_coordinator.domain_id())
            if not _ports_in_use(TABLES).isdisjoint(_ports(domain_id)):  # as by a stack that was started by hand
                continue
            try:
                reserved.enter_context(held_domain(domain_id, patience=0.0))
            except DomainInUse:  # by a program that chose it: it stays reserved, so that the next is another
                continue
            yield domain_id
            return
        raise InputError("no DDS domain is free; give one with --domain-id")


def is_known_empty(domain_id: int, environment: Mapping[str, str], tables: Sequence[Path] = TABLES) -> bool:
    """Returns whether it is certain that no participant is in a domain that nodes started in `environment` could hear.

    If the nodes are to stay on this machine, they hear only participants on it, each of which has a socket at a
    port of the domain, as in one of `tables`. For other nodes, or where these lists are unreliable, nothing is
    certain.

    The bridge would have to listen for a second instead: a participant that joins announces itself, and is answered
    at once, but before Fast DDS accepts the answer; it learns of the others when they announce themselves next,
    once a second. Without this the first step comes 1.43 times as late (1.41 to 1.66, 5 pairs).
    """
    if middleware_settings(environment).get(PROFILES[0]) != str(LOOPBACK):
        return False
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        in_use = _ports_in_use(tables)
        port = own.getsockname()[1]
    return port in in_use and (in_use - {port}).isdisjoint(_ports(domain_id))


def _ports(domain_id: int) -> range:
    """Returns the UDP ports of a domain."""
    first = FIRST_PORT + DOMAIN_PORTS * domain_id
    return range(first, first + DOMAIN_PORTS)


def _ports_in_use(tables: Sequence[Path]) -> set[int]:
    """Returns the local ports in lists of sockets; a line's second word is ADDRESS:PORT in hex."""
    ports: set[int] = set()
    for table in tables:
        with suppress(OSError):  # there is none of a protocol that the machine does without
            ports |= {int(line.split()[1].rpartition(":")[2], 16) for line in table.read_text().splitlines()[1:]}
    return ports
