"""What is packed for the page comes out again, to the resolution that was asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_eval.report.packing import Packer
from packed import unpack


@given(
    rows=st.integers(0, 4),
    columns=st.integers(0, 30),
    differences=st.integers(0, 2),
    resolution=st.sampled_from([1.0, 0.05, 0.01]),
    size=st.sampled_from([1.0, 300.0, 1e5]),
    seed=st.integers(0, 99),
)
def test_round_trip(rows: int, columns: int, differences: int, resolution: float, size: float, seed: int) -> None:
    values = np.random.default_rng(seed).uniform(-size, size, (rows, columns))
    packer = Packer({"name": "<&>"})
    packer.add("first", [1, 2, 3])
    packer.add("values", values, resolution, differences)
    content, arrays = unpack(packer.pack())
    assert content == {"name": "<&>"}
    assert arrays["first"].tolist() == [1, 2, 3]
    assert arrays["values"].shape == values.shape
    assert np.all(np.abs(arrays["values"] - values) <= 0.5 * resolution + 1e-9 * size)


def test_smooth_motion_takes_a_byte_a_step() -> None:
    packer = Packer({})
    packer.add("x", np.cumsum(np.full((200, 300), 1.37), axis=1), 0.01, 2)
    assert len(packer.pack()) < 20_000


def test_what_exceeds_32_bits_is_clipped() -> None:
    packer = Packer({})
    packer.add("x", [1e12, -1e12, 0.0], 0.01)
    _, arrays = unpack(packer.pack())
    assert arrays["x"][:2] == pytest.approx([2147483647 * 0.01, -2147483648 * 0.01])
