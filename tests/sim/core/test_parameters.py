"""Parameters by name, for who runs stages without ROS."""

from __future__ import annotations

from argparse import ArgumentTypeError
from dataclasses import dataclass
from typing import Any

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides, by_stage, one_setting, setting


@dataclass(frozen=True)
class Inner:
    name: str = "x"
    on: bool = False


@dataclass(frozen=True)
class Outer:
    """One field of each kind."""

    horizon: float = 3.0
    rounds: int = 10
    spread: tuple[float, float] = (0.5, 1.0)
    inner: Inner = Inner()


def test_values_take_the_place_of_fields_by_their_flat_names() -> None:
    read = ParameterOverrides("conflict", {"horizon": 2, "spread": [1.0, 2.0], "inner.on": True, "back.name": "y"})
    found = read(Outer())
    assert found == Outer(horizon=2.0, spread=(1.0, 2.0), inner=Inner(on=True)) and isinstance(found.horizon, float)
    assert read(Inner(), "back.") == Inner(name="y")
    read.check()


def test_what_nobody_asked_for_is_named_with_what_there_is() -> None:
    read = ParameterOverrides("conflict", {"horizont": 2.0})
    read(Inner())
    with pytest.raises(InputError, match="conflict: unknown parameter horizont; expected name, on"):
        read.check()


@pytest.mark.parametrize(
    ("name", "value"), [("horizon", "long"), ("horizon", True), ("rounds", 2.5), ("inner.on", 1), ("inner.name", 3)]
)
def test_what_does_not_fit_is_refused(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"conflict: parameter {name} is {value!r}, expected such as"):
        ParameterOverrides("conflict", {name: value})(Outer())


def test_settings_of_command_lines() -> None:
    assert setting("conflict.handback=catch_up,time_shift") == ("conflict", "handback", ["catch_up", "time_shift"])
    assert setting("ego.time=[0, 1]") == ("ego", "time", [(0, 1)])
    assert one_setting("policy.safety.contact=false") == ("policy", "safety.contact", False)
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
