"""What a benchmark says of the start of a run, from figures that are made up and from a record that is."""

import pytest

from litsim_eval.benchmark import start as start_benchmark
from litsim_eval.benchmark.start import FIRST_STEP, LIBRARIES, TORCH, measure_start, start_rows
from litsim_sim.core.errors import InputError


def test_the_slowest_import_is_that_of_each_repetition() -> None:
    quick = dict.fromkeys(LIBRARIES, 0.1)
    found = [quick | {"pyarrow": 0.5, FIRST_STEP: 2.0}, quick | {"numba": 1.0, FIRST_STEP: 3.0}]
    rows = list(start_rows(found))
    assert [name for name, _ in rows[:2]] == ["import numba, s", "import pyarrow, s"]
    assert len(rows) == len(LIBRARIES) + 3
    assert rows[-3:] == [
        ["slowest import, s", "0.75 (0.50 to 1.00)"],
        ["launcher to first step, s", "2.50 (2.00 to 3.00)"],
        ["first step / slowest import", "3.50 (3.00 to 4.00)"],
    ]


def test_where_torch_is_installed_the_start_is_also_compared_with_its_import() -> None:
    found = dict.fromkeys(LIBRARIES, 0.1) | {TORCH: 2.0, FIRST_STEP: 1.0}
    assert list(start_rows([found]))[-3:] == [
        ["first step / slowest import", "10.00 (10.00 to 10.00)"],
        ["import torch, which no run does, s", "2.00 (2.00 to 2.00)"],
        ["launcher to first step / import torch", "0.50 (0.50 to 0.50)"],
    ]


def test_libraries_are_imported_each_in_a_process_of_its_own(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start_benchmark, "LIBRARIES", ("json", "no_such_library"))
    monkeypatch.setattr(start_benchmark, "time_to_first_step", lambda *_: 1.0)
    monkeypatch.setattr(start_benchmark, "TORCH", "no_such_library")
    with pytest.raises(InputError, match="No module named 'no_such_library'"):
        measure_start(tmp_path, 5, 1, lambda: None)
    monkeypatch.setattr(start_benchmark, "LIBRARIES", ("json",))
    ticks: list[int] = []
    found = measure_start(tmp_path, 5, 2, lambda: ticks.append(1))
    assert [set(each) for each in found] == [{"json", FIRST_STEP}] * 2 and len(ticks) == 2
    monkeypatch.setattr(start_benchmark, "TORCH", "zipapp")
    assert measure_start(tmp_path, 5, 1, lambda: None)[0].keys() == {"json", "zipapp", FIRST_STEP}
