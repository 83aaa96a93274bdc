"""The garbage collector is kept off for a while, and works as before afterwards."""

from __future__ import annotations

import gc

import pytest

from litsim_sim.core.garbage import without_collection


def test_nothing_is_collected_meanwhile_and_all_is_as_before_however_it_ends() -> None:
    assert gc.isenabled()
    with without_collection():
        assert not gc.isenabled()
        with without_collection():
            pass
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(ValueError, match="in between"), without_collection():
        raise ValueError("in between")
    assert gc.isenabled()
