"""Lines as columns of numbers, and which line is named when one cannot be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from litsim_data.ngsim.formats import Layout
from litsim_data.ngsim.lines import LineParser, line_numbers, row_error
from litsim_sim.core.errors import InputError

PATH = Path("made.csv")
COLUMNS = ("vehicle_id", "frame", "time_ms", "speed", "lane")


def parser(separator: str = ",") -> LineParser:
    return LineParser(PATH, Layout(COLUMNS, separator, 0, 1), COLUMNS)


def column(data: bytes, name: str, separator: str = ",", line: int = 1) -> np.ndarray:
    reader = parser(separator)
    table = reader.parse(data, line)
    return reader.numbers(table, name, line_numbers(PATH, data, line, len(table)))


@pytest.mark.parametrize(
    ("separator", "data"),
    [(",", b"7,1,100,3.5,2\n8,2,200,4.5,1\n"), (" ", b"  7 1\t100 3.5  2 \r\n 8 2 200 4.5 1\n")],
)
def test_numbers_of_both_formats(separator: str, data: bytes) -> None:
    vehicle, speed = column(data, "vehicle_id", separator), column(data, "speed", separator)
    assert (vehicle.tolist(), vehicle.dtype) == ([7, 8], np.int64)
    assert speed.tolist() == [3.5, 4.5]


def test_thousands_commas() -> None:
    assert column(b'7,1,"1,118,847,869,000",3.5,2\n', "time_ms").tolist() == [1_118_847_869_000]


def test_lines_are_counted_over_empty_ones() -> None:
    assert line_numbers(PATH, b"a\n\nb\n", 10, 2).tolist() == [10, 12]
    assert line_numbers(PATH, b"a\nb\n", 10, 2).tolist() == [10, 11]


def test_a_quotation_mark_swallows_no_lines() -> None:
    rows = b'7,1,100,3.5,2\n7,2,200,3.5,"2\n7,3,300,3.5,2\n7,4,400,3.5,2"\n'
    with pytest.raises(InputError, match=r"made\.csv: line 6: a quotation mark that is not closed in this line"):
        column(rows, "speed", line=5)
    with pytest.raises(InputError, match=r"made\.csv: line 6: column Lane_ID is '\"', no number"):
        column(b'7 1 100 3.5 2\n7 2 200 3.5 "\n7 3 300 3.5 "\n', "lane", " ", line=5)


@pytest.mark.parametrize(
    ("row", "name", "message"),
    [
        (b"7,1,100,fast,2", "speed", r"made\.csv: line 6: column v_Vel is 'fast', no number"),
        (b"7,1.5,100,3.5,2", "frame", r"line 6: column Frame_ID is 1\.5, no whole number"),
        (b"7,1,100,,2", "speed", r"line 6: column v_Vel is empty or not finite"),
        (b"7,1,100,3.5", "speed", r"line 6: 4 columns, expected 5: '7,1,100,3\.5'"),
    ],
)
def test_the_line_that_cannot_be_read_is_named(row: bytes, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        column(b"8,1,100,3.5,2\n" + row + b"\n", name, line=5)


def test_further_rows_are_counted() -> None:
    error = row_error(PATH, np.array([4, 5, 9]), np.array([False, True, True]), "this is wrong")
    assert str(error) == "made.csv: line 5: this is wrong; and 1 more such rows in this block"
