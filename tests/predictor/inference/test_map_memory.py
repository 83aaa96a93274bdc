"""What is remembered of maps: each once, and not more than there is room for."""

import numpy as np
import pytest

from litsim_predictor.inference import map_memory
from litsim_predictor.inference.map_memory import MapCodes, MapMemory, fingerprints, first_alike
from litsim_sim.core.scene import ByteArray

WIDTH = 3


def maps(*numbers: int) -> ByteArray:
    """A map for each of the numbers, equal for equal ones."""
    return np.stack([np.full((4, 2, 2), number, np.uint8) for number in numbers])


def told(memory: MapMemory, *numbers: int) -> MapCodes:
    """Look up the maps of these numbers; the new ones are coded by their number."""
    found = memory.look_up(maps(*numbers))
    memory.keep(found, np.repeat(found.new[:, 0, 0, :1].astype(np.float32), WIDTH, axis=1))
    return found


def codes_of(found: MapCodes) -> list[float]:
    new = np.repeat(found.new[:, 0, 0, :1].astype(np.float32), WIDTH, axis=1)
    return np.concatenate([found.known, new])[found.code_of][:, 0].tolist()


def test_each_map_is_coded_once_and_every_agent_has_the_code_of_its_own() -> None:
    memory = MapMemory(WIDTH)
    first = told(memory, 7, 8, 7, 9, 9)
    assert (first.new[:, 0, 0, 0].tolist(), first.known.shape) == ([7, 8, 9], (0, WIDTH))
    assert codes_of(first) == [7, 8, 7, 9, 9]
    second = told(memory, 5, 9, 5, 8, 6, 9)
    assert (second.new[:, 0, 0, 0].tolist(), second.known[:, 0].tolist()) == ([5, 6], [9, 8])
    assert codes_of(second) == [5, 9, 5, 8, 6, 9]
    third = told(memory, 6, 7)
    assert (third.new.shape, third.known[:, 0].tolist(), codes_of(third)) == ((0, 4, 2, 2), [6, 7], [6, 7])


def test_the_oldest_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_memory, "MOST", 3)
    memory = MapMemory(WIDTH)
    told(memory, 1, 2)
    told(memory, 3, 4, 5)
    assert memory.look_up(maps(1, 2, 3, 4, 5)).new[:, 0, 0, 0].tolist() == [1, 2]
    told(memory, *range(10, 20))
    assert codes_of(told(memory, 19, 3, 18)) == [19, 3, 18]


def test_codes_are_kept_apart_from_the_answer_that_they_came_in() -> None:
    memory = MapMemory(WIDTH)
    found = memory.look_up(maps(1, 2))
    answer = np.ones((2, WIDTH), np.float32)
    memory.keep(found, answer)
    answer[:] = 0.0
    assert memory.look_up(maps(2)).known.tolist() == [[1.0] * WIDTH]


def test_rows_that_are_mixed_alike_are_not_taken_for_equal() -> None:
    """3 + 3 * 1 = 0 + 3 * 2 = 6 + 3 * 0: rows are compared where what is mixed of them is the same."""
    rows = np.array([[3, 1], [0, 2], [3, 1], [0, 2], [6, 0], [1, 1]])
    assert first_alike(rows).tolist() == [0, 1, 0, 1, 4, 5]


def test_rows_that_differ_in_one_bit_or_in_their_order_have_other_fingerprints() -> None:
    row = np.random.default_rng(0).integers(0, 2**63, 288).astype(np.uint64)
    one_bit = np.array(
        [row ^ np.where(np.arange(288) == k, np.uint64(1 << bit), 0) for k in range(288) for bit in (0, 63)]
    )
    in_order = np.array([np.roll(row, k) for k in range(288)])
    same_sum = row + np.where(np.arange(288) == 3, 1, 0).astype(np.uint64)
    same_sum[4] -= np.uint64(1)
    rows = np.concatenate([one_bit, in_order, same_sum[None]])
    found = fingerprints(rows, np.arange(len(rows)))
    assert len(np.unique(found[:, 0])) == len(np.unique(found[:, 1])) == len(rows)
    again = fingerprints(rows[::-1].copy(), np.array([0, len(rows) - 1]))
    assert again.tolist() == found[[-1, 0]].tolist()
