"""Values as people read them."""

from typing import Any

import pytest

from litsim_eval.report.wording import branches, is_nested, leaf, lockstep_text, number, percent


def test_numbers_and_shares() -> None:
    assert [number(3), number(3.14159), number(0.5, 1, "m"), number(None)] == ["3", "3.14", "0.5 m", "–"]
    assert [percent(0.1234), percent(1), percent(None)] == ["12.3 %", "100.0 %", "–"]


def test_what_of_the_ego_was_of_no_use_is_told_with_lockstep() -> None:
    own = {"missed": 1, "gaps": 0, "ego_port": {}}
    assert lockstep_text(own) == "1 missed answers, 0 gaps"
    port = {"interface": "twist", "answered": 281, "late": 0, "stale": 3, "surplus": 400}
    told = lockstep_text(own | {"ego_port": port})
    assert told == "1 missed answers, 0 gaps; of the ego's messages 3 stale, 400 surplus"
    again = {"interface": "twist", "answered": 281, "late": 0, "joined": 1}
    assert (
        lockstep_text(own | {"ego_port": again})
        == "1 missed answers, 0 gaps; 1 publishers of the ego joined in mid-run"
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        ("", "–"),
        ([], "–"),
        ({}, "–"),
        (True, "yes"),
        (1234.56, "1235"),
        (7, "7"),
        ([1, 0.5, None], "1, 0.5, –"),
    ],
)
def test_leaves(value: Any, text: str) -> None:
    assert branches(value) == []
    assert not is_nested(value)
    assert leaf(value) == text


def test_levels() -> None:
    assert branches({"a": 1, 2: [3]}) == [("a", 1), ("2", [3])]
    assert branches([{"a": 1}, 5]) == [("0", {"a": 1}), ("1", 5)]
    assert is_nested({"a": {}}) and is_nested([[1]])
    assert not is_nested({"a": 1})
