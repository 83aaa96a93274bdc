"""The digest changes with everything that a run decides, and with nothing else."""

import hashlib
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.scene import ARRAY_FIELDS, CONTROL_DTYPES, DTYPES, AgentTable, ControlTable, EgoCommand, EgoMode
from litsim_sim.record.digest import VERSION, RunDigest


def agents() -> AgentTable:
    return AgentTable(7, *(np.arange(3, dtype=DTYPES[f]) + i for i, f in enumerate(ARRAY_FIELDS)))


def controls() -> ControlTable:
    return ControlTable(7, *(np.arange(2).astype(np.dtype(t)) for t in CONTROL_DTYPES.values()))


EGO = EgoCommand(7, 0.5, -0.25)


def digest(*parts: Any) -> str:
    total = RunDigest()
    total.update(*parts)
    return total.hexdigest()


USUAL = digest(agents(), controls(), EGO)


def changed(array: np.ndarray) -> np.ndarray:
    """The smallest possible change of the last element."""
    out = array.copy()
    out[-1] = np.nextafter(out[-1], np.inf) if array.dtype.kind == "f" else out[-1] + 1
    return out


def test_equal_inputs_give_equal_digests_also_from_views_of_other_layout() -> None:
    strided = AgentTable(7, *(np.repeat(getattr(agents(), f), 2)[::2] for f in ARRAY_FIELDS))
    assert digest(agents(), controls(), EGO) == USUAL == digest(strided, controls(), EGO)


@pytest.mark.parametrize("field", ARRAY_FIELDS)
def test_any_value_of_an_agent_counts(field: str) -> None:
    other = replace(agents(), **{field: changed(getattr(agents(), field))})
    assert digest(other, controls(), EGO) != USUAL


@pytest.mark.parametrize("field", CONTROL_DTYPES)
def test_any_value_of_a_control_counts(field: str) -> None:
    other = replace(controls(), **{field: changed(getattr(controls(), field))})
    assert digest(agents(), other, EGO) != USUAL


@pytest.mark.parametrize(
    "ego",
    [
        EgoCommand(8, 0.5, -0.25),
        EgoCommand(7, np.nextafter(0.5, 1), -0.25),
        EgoCommand(7, 0.5, np.nextafter(-0.25, 1)),
        EgoCommand(7, 0.5, -0.25, EgoMode.FOLLOW_LOG),
        None,
    ],
)
def test_any_value_of_the_ego_counts(ego: EgoCommand | None) -> None:
    assert digest(agents(), controls(), ego) != USUAL


def test_an_answer_for_nobody_is_not_no_answer() -> None:
    assert digest(agents(), ControlTable.empty(7), EGO) != digest(agents(), None, EGO)


def test_the_step_and_the_order_of_steps_count() -> None:
    first, second = RunDigest(), RunDigest()
    for step in (0, 1):
        first.update(AgentTable.empty(step), None, None)
        second.update(AgentTable.empty(1 - step), None, None)
    assert first.hexdigest() != second.hexdigest()


def test_the_bytes_are_those_of_the_description() -> None:
    table = agents().take(np.array([0]))
    expected = VERSION + struct.pack("<cII", b"A", 7, 1)
    expected += struct.pack("<qBB8d", 0, 1, 2, *(float(i) for i in range(3, 11)))
    expected += struct.pack("<cIIqqdddddd", b"C", 7, 2, 0, 1, 0, 1, 0, 1, 0, 1) + bytes([0, 1])
    expected += struct.pack("<cIBdd", b"E", 7, 0, 0.5, -0.25)
    assert digest(table, controls(), EGO) == hashlib.sha256(expected).hexdigest()
