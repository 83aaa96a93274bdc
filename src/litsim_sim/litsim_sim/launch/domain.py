"""DDS domains: which one a graph is to use."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager, nullcontext

import domain_coordinator

from litsim_sim.core.errors import InputError

DOMAIN_IDS = range(233)  # beyond, the ports of DDS have run out


def graph_domain(domain_id: int | None, *, reserve: bool) -> AbstractContextManager[int]:
    """The DDS domain of a graph: `domain_id`, else that of the environment.

    Where the user has chosen none: a free one that is reserved meanwhile, if `reserve`, else 0.

    Raises:
        InputError: there is no such domain.
    """
    chosen = os.environ.get("ROS_DOMAIN_ID") if domain_id is None else str(domain_id)
    if not chosen and reserve:
        return domain_coordinator.domain_id()
    chosen = chosen or "0"
    if not chosen.isdecimal() or int(chosen) not in DOMAIN_IDS:
        raise InputError(f"ROS_DOMAIN_ID is {chosen!r}, expected {DOMAIN_IDS[0]} to {DOMAIN_IDS[-1]}")
    return nullcontext(int(chosen))
