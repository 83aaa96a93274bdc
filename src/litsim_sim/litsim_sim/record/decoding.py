"""Decoding of recorded messages by the definitions in their bag, within budgets: both may be anybody's."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from litsim_sim.core.checks import DEFINITION_BYTES_MAX, LEVELS_MAX, check_budget
from litsim_sim.record.bag import BagTopic

UNDECODABLE = (
    SerdeError,
    TypesysError,
    struct.error,
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    TypeError,
    ValueError,
)
"""Errors raised for a message or a definition that this version cannot read."""


def decoded(topic: BagTopic, data: bytes) -> Any:
    """Returns a message of `topic` from its CDR; raises one of UNDECODABLE if that or its definition cannot be read."""
    store = typestore(topic.definition, topic.type_name)
    check_size(store, topic.type_name, data)
    return store.deserialize_cdr(data, topic.type_name)


@lru_cache(maxsize=256)
def typestore(definition: str, type_name: str) -> Typestore:
    """Returns the types of one definition: those of several topics of a bag may differ under one name."""
    check_budget(f"bytes of the definition of {type_name}", len(definition), DEFINITION_BYTES_MAX)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, type_name))
    return store


def check_size(store: Typestore, type_name: str, data: bytes) -> None:
    """Raise ValueError if every message of a type is larger than the CDR of this one."""
    check_budget(f"values in a {type_name} of {len(data)} bytes", least_values(store, type_name), len(data))


@lru_cache(maxsize=256)
def least_values(store: Typestore, type_name: str) -> int:
    """Returns how many values any message of a type has, each of a byte at least; an array of variable length is one.

    Raises:
        ValueError: messages are within each other more deeply than LEVELS_MAX.
    """
    counted: dict[str, int] = {}

    def of_type(name: str, level: int) -> int:
        if name not in counted:
            check_budget(f"levels of messages in {type_name}", level, LEVELS_MAX)
            counted[name] = sum(of_field(description, level) for _, description in store.fielddefs[name][1])
        return counted[name]

    def of_field(description: Any, level: int) -> int:
        kind, inner = description
        if kind == Nodetype.ARRAY:
            return of_field(inner[0], level) * int(inner[1])
        if kind == Nodetype.SEQUENCE:
            of_field(inner[0], level)
        return of_type(inner, level + 1) if kind == Nodetype.NAME else 1

    return of_type(type_name, 1)
