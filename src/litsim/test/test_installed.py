"""What `colcon test` proves of this package where it was built: all that it names can be imported."""

import litsim


def test_everything_named_is_there() -> None:
    assert {"Scenario", "Simulation", "evaluate", "load_run"} <= {*litsim.__all__}
    assert all(getattr(litsim, name).__doc__ for name in litsim.__all__)
