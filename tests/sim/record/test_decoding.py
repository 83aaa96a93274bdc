"""Messages and definitions that ask for more than a machine has are refused before anything is made for them."""

import struct

import pytest

from litsim_sim.record.bag import BagTopic
from litsim_sim.record.decoding import decoded

RULE = "\n" + "=" * 80 + "\n"
HEAD = b"\0\1\0\0"


def topic(definition: str, *others: str) -> BagTopic:
    """A topic of type p/T; `others` are the definitions of p/A, p/B and so on."""
    parts = [definition, *(f"MSG: p/{chr(ord('A') + i)}\n{text}" for i, text in enumerate(others))]
    return BagTopic("/t", "p/msg/T", RULE.join(parts))


def test_arrays_that_fit_are_read() -> None:
    message = decoded(topic("A[2] a\nuint8[] n", "uint8 x"), HEAD + b"\1\2\0\0" + struct.pack("<I", 1) + b"\7")
    assert ([each.x for each in message.a], message.n.tolist()) == ([1, 2], [7])


@pytest.mark.parametrize(
    ("described", "said"),
    [
        (topic("float64[999999999] x"), "values in a p/msg/T of 20 bytes: 999999999, expected at most 20"),
        (topic("A[999999999] a", "string s"), "values in a p/msg/T of 20 bytes: 999999999"),
        (topic("A[99999] a", "B[99999] b", "uint8 x"), "values in a p/msg/T of 20 bytes: 9999800001"),
        (topic("A[999999999] a", ""), "values in a p/msg/T of 20 bytes: 999999999"),
        (topic("A a", "T t"), "levels of messages in p/msg/T: 21, expected at most 20"),
        (topic("A[] a", "A[] a"), "levels of messages in p/msg/T: 21, expected at most 20"),
        (topic("uint8 x # " + 70_000 * "."), "bytes of the definition of p/msg/T: 70010, expected at most 65536"),
    ],
)
def test_definitions_beyond_the_budget_are_refused(described: BagTopic, said: str) -> None:
    with pytest.raises(ValueError, match=f"^{said}"):
        decoded(described, HEAD + bytes(16))


@pytest.mark.parametrize("element", ["uint8", "string", "A", "float64"])
def test_a_message_cannot_claim_more_than_it_holds(element: str) -> None:
    with pytest.raises(Exception, match=r".") as error:
        decoded(topic(f"{element}[] x", "string s"), HEAD + struct.pack("<I", 2**32 - 1) + bytes(16))
    assert not isinstance(error.value, MemoryError)
