"""The garbage collector is kept off for a while, and works as before afterwards."""

import gc

import pytest

from litsim_sim.kernels.garbage import spared_from_collection, without_collection


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


def test_what_there_is_is_spared_meanwhile_and_what_comes_is_collected() -> None:
    before = gc.get_freeze_count()  # Python 3.12 begins with a few hundred
    with spared_from_collection():
        assert gc.get_freeze_count() > before
        loop: list[object] = []
        loop.append(loop)
        del loop
        assert gc.collect() > 0
    assert gc.get_freeze_count() == 0  # nothing is kept from the collector from then on
    with pytest.raises(ValueError, match="in between"), spared_from_collection():
        raise ValueError("in between")
    assert gc.get_freeze_count() == 0
