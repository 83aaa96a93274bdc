"""Types of the fields of configurations."""

from dataclasses import FrozenInstanceError, replace
from typing import Annotated, Literal

import pytest
from pydantic import Field, ValidationError

from litsim_sim.core.quantities import (
    Duration,
    Flag,
    Horizon,
    Length,
    Number,
    OneOf,
    OpenShare,
    Positive,
    Share,
    Speed,
    Steps,
    Whole,
    configuration,
    expected,
    field_type,
    unit,
)
from litsim_sim.core.scene import STEP_S


@configuration
class Plain:
    horizon: Horizon = 1.0
    kind: Annotated[str, OneOf(("a", "b"))] = "a"
    pair: tuple[Positive[Steps], Positive[Steps]] = (1, 2)


@pytest.mark.parametrize(
    ("annotation", "words", "symbol"),
    [
        (Positive[Duration], "a number of more than 0 [s]", "s"),
        (Length, "a number [m]", "m"),
        (Positive[Steps], "a whole number of more than 0 and at most 36000 [steps]", "steps"),
        (Annotated[Whole, Field(ge=-1)], "a whole number of at least -1", ""),
        (Share, "a number of at least 0 and at most 1", ""),
        (OpenShare, "a number of more than 0 and less than 1", ""),
        (Horizon, f"a number of at least {STEP_S:g} and at most 60 [s]", "s"),
        (Flag, "true or false", ""),
        (str, "a text", ""),
        (Literal["stop", "hold"], "one of stop, hold", ""),
        (Annotated[str, OneOf(("a", "b"))], "one of a, b", ""),
        (tuple[Speed, Speed], "a list of 2, each a number [m/s]", "m/s"),
        (tuple[Number, ...], "a list, each a number", ""),
    ],
)
def test_types_in_words(annotation: object, words: str, symbol: str) -> None:
    assert expected(annotation) == words
    assert unit(annotation) == symbol


def test_types_of_fields_keep_bounds_and_units() -> None:
    assert expected(field_type(Plain, "horizon")) == expected(Horizon)
    assert expected(field_type(Plain, "kind")) == "one of a, b"
    assert expected(field_type(Plain, "pair")) == f"a list of 2, each {expected(Positive[Steps])}"


@pytest.mark.parametrize(
    "values",
    [
        {"horizon": 0.05},
        {"horizon": 1e12},
        {"horizon": "1"},
        {"kind": "c"},
        {"pair": (0, 1)},
        {"pair": (1, 10**12)},
        {"pair": (1, 2, 3)},
        {"hrizon": 1.0},
    ],
)
def test_what_does_not_fit_makes_no_configuration(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Plain(**values)
    if "hrizon" not in values:
        with pytest.raises(ValidationError):
            replace(Plain(), **values)


def test_a_configuration_stays_as_it_was_made() -> None:
    config = Plain(horizon=2, pair=[3, 4])
    assert (config.horizon, config.pair) == (2.0, (3, 4)) and isinstance(config.horizon, float)
    with pytest.raises(FrozenInstanceError):
        config.horizon = 3.0
