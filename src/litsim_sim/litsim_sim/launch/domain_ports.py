"""Whether any participant is in a DDS domain whose nodes stay on this machine, read from the sockets at once.

Listening instead takes a second: a participant that joins announces itself, and is answered at once, but before Fast
DDS accepts the answer; it learns of the others when they announce themselves next, once a second. Without this the
first step comes 1.43 times as late (1.41 to 1.66, 5 pairs).
"""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from litsim_sim.launch.middleware import LOOPBACK, PROFILES, middleware_settings

FIRST_PORT, DOMAIN_PORTS = 7400, 250
"""First UDP port of domain 0, and number of ports of each domain (DDSI-RTPS 2.5, 9.6.2: PB, DG)."""
TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))
"""The UDP sockets of this machine, or of this container, as Linux lists them."""

EMPTY = "LITSIM_DOMAIN_EMPTY"
"""Variable that tells the bridge of a graph which domain was empty before any process of that graph was there."""


def is_known_empty(domain_id: int, environment: Mapping[str, str], tables: Sequence[Path] = TABLES) -> bool:
    """Whether it is certain that no participant is in a domain that nodes started in `environment` could hear.

    If the nodes are to stay on this machine, they hear only participants on it, each of which has a socket at a port of
    the domain. For other nodes, or where the system's list of sockets is unreliable, nothing is certain.

    Args:
        domain_id: the domain.
        environment: variables of the processes that the nodes are started in.
        tables: lists of sockets; that of a protocol that the machine does without is absent.
    """
    if middleware_settings(environment).get(PROFILES[0]) != str(LOOPBACK):
        return False
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        taken = set(_taken(tables))
        known = own.getsockname()[1]
    return known in taken and (taken - {known}).isdisjoint(_ports(domain_id))


def is_in_use(domain_id: int, tables: Sequence[Path] = TABLES) -> bool:
    """Whether there is a socket on this machine at a port of the domain, which is most likely that of a participant."""
    return not set(_taken(tables)).isdisjoint(_ports(domain_id))


def _ports(domain_id: int) -> range:
    first = FIRST_PORT + DOMAIN_PORTS * domain_id
    return range(first, first + DOMAIN_PORTS)


def _taken(tables: Sequence[Path]) -> Iterator[int]:
    """Local ports in lists of sockets; after a line of headings the second word of each is ADDRESS:PORT, in hex."""
    for table in tables:
        try:
            lines = table.read_text().splitlines()[1:]
        except OSError:
            continue
        yield from (int(line.split()[1].rpartition(":")[2], 16) for line in lines)
