"""Parameters by name, for who runs stages without ROS."""

from __future__ import annotations

from argparse import ArgumentTypeError
from typing import Any

import pytest
from pydantic import model_validator

from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides, by_stage, one_setting, setting
from litsim_sim.core.quantities import Duration, Flag, NonNegative, Positive, Speed, Whole, at_most, configuration


@configuration
class Inner:
    name: str = "x"
    on: Flag = False
    near: Duration = 1.0
    far: Duration = 2.0

    @model_validator(mode="after")
    def _check(self) -> Inner:
        at_most(self, "near", "far")
        return self


@configuration
class Outer:
    """One field of each kind."""

    horizon: Positive[Duration] = 3.0
    rounds: Whole = 10
    spread: tuple[NonNegative[Speed], Speed] = (0.5, 1.0)
    inner: Inner = Inner()


def test_values_take_the_place_of_fields_by_their_flat_names() -> None:
    read = ParameterOverrides("conflict", {"horizon": 2, "spread": [1.0, 2.0], "inner.on": True, "back.name": "y"})
    found = read(Outer())
    assert found == Outer(horizon=2.0, spread=(1.0, 2.0), inner=Inner(on=True)) and isinstance(found.horizon, float)
    assert read(Inner(), "back.") == Inner(name="y")
    read.check()
    assert read.values["horizon"] == 2.0 and read.values["spread"] == (1.0, 2.0) and read.values["back.name"] == "y"


def test_what_nobody_asked_for_is_named_with_what_there_is() -> None:
    read = ParameterOverrides("conflict", {"nam": "x", "zeal": 2.0})
    read(Inner())
    with pytest.raises(
        InputError, match=r"conflict: unknown parameter nam \(near: name\), zeal; expected far, name, near, on"
    ):
        read.check()
    nobody = ParameterOverrides("recorder", {"horizon": 2.0})
    with pytest.raises(InputError, match="recorder: unknown parameter horizon; expected none"):
        nobody.check()


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("horizon", "long", "a number of more than 0 [s]"),
        ("horizon", True, "a number of more than 0 [s]"),
        ("horizon", None, "a number of more than 0 [s]"),
        ("horizon", 0, "a number of more than 0 [s]"),
        ("horizon", float("inf"), "a number of more than 0 [s]"),
        ("rounds", 2.5, "a whole number"),
        ("rounds", 2.0, "a whole number"),
        ("inner.on", 1, "true or false"),
        ("inner.name", 3, "a text"),
        ("spread", [1.0], "a list of a number of at least 0 [m/s], then a number [m/s]"),
        ("spread", (1, 2, 3), "a list of a number of at least 0 [m/s], then a number [m/s]"),
        ("spread", [-1, 2], "a list of a number of at least 0 [m/s], then a number [m/s]"),
        ("spread", 1.0, "a list of a number of at least 0 [m/s], then a number [m/s]"),
        ("inner.near", 5.0, "at most far, which is 2.0"),
    ],
)
def test_what_does_not_fit_is_refused(name: str, value: Any, expected: str) -> None:
    with pytest.raises(InputError) as error:
        ParameterOverrides("conflict", {name: value})(Outer())
    assert str(error.value) == f"conflict: parameter {name} is {value!r}, expected {expected}"


def test_all_that_does_not_fit_is_said_in_one_line() -> None:
    with pytest.raises(
        InputError, match=r"^conflict: parameter horizon is -1, .*; parameter rounds is 'x', expected .*$"
    ):
        ParameterOverrides("conflict", {"horizon": -1, "rounds": "x"})(Outer())


def test_settings_of_command_lines() -> None:
    assert setting("conflict.handback=catch_up,time_shift") == ("conflict", "handback", ["catch_up", "time_shift"])
    assert setting("ego.time=[0, 1]") == ("ego", "time", [(0, 1)])
    assert one_setting("policy.safety.contact=false") == ("policy", "safety.contact", False)
    assert setting("ego.deceleration=1e-05,2e0") == ("ego", "deceleration", [1e-05, 2.0])
    settings = [("ego", "kind", "brake"), ("ego", "duration", 1.0), ("ego", "kind", "mixed")]
    assert by_stage(settings) == {"ego": {"kind": "mixed", "duration": 1.0}}


@pytest.mark.parametrize(
    "text", ["", "conflict", "conflict.horizon", "horizon=2", "conflict.horizon=", "a.b=[", ".b=1"]
)
def test_settings_that_are_none(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match=r"expected STAGE\.NAME=VALUE"):
        setting(text)


def test_one_setting_is_one() -> None:
    with pytest.raises(ArgumentTypeError, match="expected one value, found 2"):
        one_setting("conflict.horizon=1.0,2.0")
