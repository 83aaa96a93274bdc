"""Settings of the middleware that LitSim's nodes run with, unless the user has settings of their own.

They are those of Fast DDS, which reads them from a file that the environment names. Where discovery stays on this
machine (``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST``), the nodes use sockets of the loopback interface alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from litsim_sim.core.errors import InputError

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PEERS = "ROS_STATIC_PEERS"
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Variables by which a user makes Fast DDS read settings; if one is set, LitSim sets none."""
LOOPBACK, NETWORK = (Path(__file__).with_name(name) for name in ("loopback.xml", "network.xml"))
"""Settings for nodes that stay on this machine, and for those that others may reach."""
FAST_DDS = "rmw_fastrtps"
SECURITY, STRATEGY, ENFORCE = "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY", "Enforce"
LOG_FOLDERS = ("ROS_LOG_DIR", "ROS_HOME", "HOME")
"""Variables that name, in this order, the folder for logs of ROS, or one above it."""
ENCLAVE = "ROS_SECURITY_ENCLAVE_OVERRIDE"
ENCLAVE_OPTIONS = {"--enclave", "-e"}
"""Variable, and ROS arguments, by which a user chooses the keys and permissions of a process."""


def middleware_settings(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns the variables to set in `environment` before a node is made; none if the user has chosen settings."""
    if any(environment.get(name) for name in PROFILES):
        return {}
    if not environment.get("RMW_IMPLEMENTATION", FAST_DDS).startswith(FAST_DDS):
        return {}
    if environment.get(RANGE) == "LOCALHOST" and not environment.get(PEERS):
        # rmw_fastrtps has transports of its own for LOCALHOST, beside any in a file; with this range it has none.
        return {PROFILES[0]: str(LOOPBACK), RANGE: "SYSTEM_DEFAULT"}
    return {PROFILES[0]: str(NETWORK)}


def enclave_setting(environment: Mapping[str, str], program: str, argv: Sequence[str] = ()) -> dict[str, str]:
    """Returns the variables to set in `environment` for `program`, with the arguments `argv`, to be in its enclave.

    None if DDS Security is not requested, or the user has chosen an enclave.
    """
    chosen = environment.get(ENCLAVE) or ENCLAVE_OPTIONS & set(argv)
    return {ENCLAVE: f"/litsim/{program}"} if is_secured(environment) and not chosen else {}


def is_secured(environment: Mapping[str, str]) -> bool:
    """Returns whether DDS Security is requested."""
    return environment.get(SECURITY, "").lower() == "true"


def check_security(environment: Mapping[str, str]) -> None:
    """Check that DDS Security, if `environment` requests it, is enforced; otherwise ROS may silently run without it.

    If it is enforced, a middleware built without DDS Security, such as that of the wheels, refuses to make nodes.

    Raises:
        InputError: it is requested, but not enforced.
    """
    strategy = environment.get(STRATEGY, "")
    if is_secured(environment) and strategy != ENFORCE:
        raise InputError(
            f"{SECURITY} is true, but {STRATEGY} is {strategy!r}, expected {ENFORCE!r}: else nodes without an enclave "
            "run unprotected"
        )


def check_logging(environment: Mapping[str, str]) -> None:
    """Raise InputError if no variable names a folder for the logs of ROS, without which no node starts."""
    if not any(environment.get(name) for name in LOG_FOLDERS):
        raise InputError(f"none of {', '.join(LOG_FOLDERS)} is set; set ROS_LOG_DIR to a folder for the logs of ROS")


def use_middleware_settings(program: str, argv: Sequence[str] = ()) -> None:
    """Use these settings for the nodes of this process, in the enclave of `program`, whose arguments are `argv`.

    To be called before the first node is made.

    Raises:
        InputError: see :func:`check_logging`.
    """
    check_logging(os.environ)
    os.environ.update(middleware_settings(os.environ) | enclave_setting(os.environ, program, argv))


@contextmanager
def middleware_in_use(program: str) -> Iterator[None]:
    """Like :func:`use_middleware_settings`, but only within the context; restores the environment afterwards."""
    before = dict(os.environ)
    use_middleware_settings(program)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
