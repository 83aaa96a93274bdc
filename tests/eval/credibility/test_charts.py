"""Charts: where values lie, and lines that break where values are missing."""

import numpy as np
import pytest

from litsim_eval.credibility.charts import HEIGHT, LEFT, RIGHT, TOP, WIDTH, Chart, Line, shares_up_to, span

NAN = np.nan


def test_a_line_breaks_where_values_are_missing() -> None:
    line = Line("some", 0, np.arange(6.0), np.array([0.0, 1.0, NAN, 1.0, 1.0, NAN]))
    drawn = Chart("some", [line], (0.0, 5.0), (0.0, 1.0)).drawn()
    assert [len(each["points"].split()) for each in drawn["lines"]] == [2, 2]


def test_ends_of_the_range_are_the_edges_of_the_frame() -> None:
    line = Line("some", 0, np.array([0.0, 5.0, 9.0]), np.array([0.0, 1.0, 2.0]))
    (only,) = Chart("some", [line], (0.0, 5.0), (0.0, 1.0)).drawn()["lines"]
    first, *others = only["points"].split()
    assert first == f"{LEFT},{HEIGHT - 22.0}" and others == [f"{WIDTH - RIGHT},{TOP}"] * 2  # beyond: at the edge


def test_shares_count_what_is_absent_but_never_reach_it() -> None:
    line = shares_up_to("some", 0, np.array([1.0, 2.0, NAN, NAN]), (0.0, 3.0))
    assert (line.x[0], line.y[0]) == (0.0, 0.0) and (line.x[-1], line.y[-1]) == (3.0, 0.5)
    assert line.y[line.x == 1.0].tolist() == [0.0, 0.25]


def test_span_leaves_out_the_outermost() -> None:
    low, high = span([np.array([*np.linspace(0.0, 1.0, 99), 1000.0])])
    assert low == pytest.approx(0.0, abs=0.1) and high == pytest.approx(1.0, abs=0.1)
    assert span([np.array([NAN])]) == (0.0, 1.0)
