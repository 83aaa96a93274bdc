"""Decoding of recorded messages by the definitions in their bag."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

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
    return typestore(topic.definition, topic.type_name).deserialize_cdr(data, topic.type_name)


@lru_cache(maxsize=256)
def typestore(definition: str, type_name: str) -> Typestore:
    """Returns the types of one definition: those of several topics of a bag may differ under one name."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, type_name))
    return store
