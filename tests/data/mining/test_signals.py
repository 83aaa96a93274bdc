"""Whether plans and what signals showed protect a turn."""

import numpy as np
import pytest

from litsim_data.mining.signals import Protection, WaySignals
from litsim_sim.core.signals import SignalState

TURNING, CROSSED = ("a_0", "b_0"), ("c_0", "d_0")


@pytest.mark.parametrize(
    ("turning", "crossed", "expected"),
    [
        pytest.param("Gr", "rG", Protection.PROTECTED, id="a phase of its own"),
        pytest.param("gr", "Gr", Protection.PERMISSIVE, id="only with them"),
        pytest.param("gGr", "Grr", Protection.PROTECTED, id="with them, and then alone"),
        pytest.param("Gyr", "GyrG", Protection.PROTECTED, id="lights that are not in step"),
        pytest.param("rGr gr", "Grr Gr", Protection.PERMISSIVE, id="alone in one program only"),
        pytest.param("gr rGr", "Gr Grr", Protection.PERMISSIVE, id="alone in the other program only"),
        pytest.param("rGr OO", "Grr oo", Protection.PROTECTED, id="alone in one program, and another is off"),
        pytest.param("Gr", "", Protection.PERMISSIVE, id="they have no signal"),
        pytest.param("", "Gr", Protection.NONE, id="it has none"),
        pytest.param("", "", Protection.NONE, id="nobody has one"),
    ],
)
def test_where_nothing_is_known_of_what_was_shown_the_plans_tell(
    turning: str, crossed: str, expected: Protection
) -> None:
    plans = {way: tuple(plan.split()) for way, plan in ((TURNING, turning), (CROSSED, crossed)) if plan}
    assert WaySignals(plans).protection(TURNING, CROSSED, 0) == expected


def test_what_was_shown_goes_before_the_plans() -> None:
    shown = np.array([SignalState.RED, SignalState.GREEN, SignalState.UNAVAILABLE], np.uint8)
    signals = WaySignals({TURNING: ("gr",), CROSSED: ("Gr",)}, {TURNING: shown, CROSSED: shown})
    found = [signals.protection(TURNING, CROSSED, step) for step in range(3)]
    assert found == [Protection.PROTECTED, Protection.PERMISSIVE, Protection.PERMISSIVE]
